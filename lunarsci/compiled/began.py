"""When this process began to read its sources."""

import time

BEGAN = time.time()
"""About when: what is newer need not be what it compiles. [s]"""
