"""From a window of events to first guesses of motion and pose."""
