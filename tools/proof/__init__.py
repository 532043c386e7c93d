"""``make proof``: a detector trained on what tagmill recorded and erased finds objects that bear no markers."""
