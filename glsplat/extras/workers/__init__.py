"""Workers: renderers in other processes, on this machine or on others, behind one gateway (docs/scaling.md)."""

REQUIRES = ()
