"""Names of other libraries, for programs that are ported."""
