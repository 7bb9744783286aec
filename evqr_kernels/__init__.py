"""Array-in, array-out kernels for event cameras and planar codes."""
