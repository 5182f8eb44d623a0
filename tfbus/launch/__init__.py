"""Launch files: processes described in YAML, started and stopped together."""
