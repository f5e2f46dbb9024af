"""Workers: renderers in other processes, on this machine or in a Ray cluster, behind one server (docs/scaling.md).

`pool.WorkerPool` replaces the server's render loop; `glsplat serve --workers` makes it by `options.Workers`.
"""

REQUIRES = ()
