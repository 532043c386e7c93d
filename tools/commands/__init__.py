"""The sub-commands that talk to a running stack over its command socket; one module each."""
