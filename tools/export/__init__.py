"""`tagmill export`: from sessions to a training set in a trainer's own format, checked by that trainer's loader."""
