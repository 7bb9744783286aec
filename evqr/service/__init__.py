"""A line as a service: one file of settings, from the source of events to where records go."""
