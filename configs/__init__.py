"""Launch files and Zenoh configurations, installed as `tfbus.configs`."""
