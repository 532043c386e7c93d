"""No search for garbage while a service imports and opens: there is none, and looking takes a seventh of its start.

``common.first`` imports this before all else; ``common.service.memory.keep_all`` ends it.
"""

import gc

gc.disable()
