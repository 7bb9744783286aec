"""Symbols: where their modules are, which are known, and what they say."""
