"""Rivals of the solver, on the same motion and the same kernels: what it is measured against.

``integrate``  today's strongest simple way: compensate the motion, integrate along it, read the image
``descent``    the paper's own gradient descent
"""
