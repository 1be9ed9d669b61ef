"""Many studies at once: the points of a sweep, its folder, the processes that run it, and its command."""
