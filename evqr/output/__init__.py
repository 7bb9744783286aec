"""Results as records, text and pictures."""
