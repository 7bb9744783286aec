"""Where records of a line go: sinks, each behind an outlet that keeps records while its sink is away."""
