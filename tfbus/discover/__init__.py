"""The members of a bus: nodes, topics, services, namespaces."""
