"""Who is there: nodes, topics, services, namespaces."""
