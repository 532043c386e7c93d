"""`tagmill calibrate`: from pictures of a board to a calibration file that says how good it is."""
