"""The `tfbus` command."""
