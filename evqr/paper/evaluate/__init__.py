"""How well methods read: metrics, the paper's table, its figures, a report."""
