"""Ways to read a code, the paper's rivals, today's, and the solver itself, behind one interface (`method`).

``camera``      row 1, a frame camera
``bardow``      row 2, optical flow and intensity at once (Bardow et al. 2016)
``without_qr``  row 3, the paper's cost without the code space
``descent``     row 4, the paper's own gradient descent; ``start``, where it starts from
``evqr``        row 5, `evqr.Solver`
``integrate``   row 6a, motion compensated and integrated along it, an ordinary decoder
``decay``       row 6b, a decaying accumulator, an ordinary decoder
``pattern``     how rows 1 to 3 find a code in an image
``event_image`` the image of a window's events, of rows 3 and 4
"""
