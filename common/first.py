"""What a service's process sees to before it imports anything else: each ``__main__`` imports this first."""

from common import early_gc, early_nice, early_signals, one_thread

__all__ = ["early_gc", "early_nice", "early_signals", "one_thread"]
