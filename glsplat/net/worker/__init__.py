"""A worker draws pictures: on a thread, in a process of this machine, or elsewhere; it is reached by one protocol."""
