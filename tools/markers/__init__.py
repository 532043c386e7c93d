"""`tagmill markers`: print-ready markers and calibration boards at true scale."""
