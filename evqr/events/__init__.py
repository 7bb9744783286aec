"""Events: columns, windows, and the buffer of a stream."""
