"""Who is who on a closed bus, and what each may do."""
