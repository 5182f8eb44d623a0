"""From a bus into a recording, and from a recording onto a bus."""
