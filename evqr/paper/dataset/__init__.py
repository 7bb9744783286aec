"""The paper's data set, made again: 18 scenes with truth; and a manifest for recordings of one's own."""
