"""Codes that pass: searched for, followed, read."""
