"""What the services share; knows no service."""

import os

VERSION = "0.1.0"

MOST_PIXELS = 1 << 26
"""Of a picture file, 67 megapixels: a few hundred bytes of PNG can claim a thousand times as many."""
# OpenCV reads it once, while it is being imported: here it comes first, whoever imports what.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", str(MOST_PIXELS))
