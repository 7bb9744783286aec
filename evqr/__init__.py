"""Read 2-D codes from event cameras."""
