"""A named process: topics, services, actions, parameters, its clock."""
