"""What the services share; knows no service."""

VERSION = "0.1.0"
