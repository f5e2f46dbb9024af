"""The commands of ``glsplat``, one small module each: HELP, EXAMPLE, add_arguments(parser), run(args) -> exit code."""
