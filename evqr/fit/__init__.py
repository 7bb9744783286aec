"""From a hypothesis and a window of events to pose, gain, lags and modules."""
