"""The operator's console: a web page and what it needs; it can do nothing that the command socket can't."""
