"""Values to bytes and names on the bus; no sockets."""
