"""Every parameter of splats fitted to pictures by gradient descent, in kernels that numba compiles (extra ``make``)."""
