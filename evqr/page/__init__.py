"""The page of a line: what passes, what is read, and what is not, in a browser on the same machine."""
