"""Sources of events that have no end: bytes that come over a connection, decoded as they do."""
