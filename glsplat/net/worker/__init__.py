"""Workers draw pictures: on a thread of the server, in a process of this machine, or on another machine."""
