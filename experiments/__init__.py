"""The command line: one file per command, each a flat script over the library.

A command file holds `HELP` (one line), `configure(parser)` and `main(args) -> int`. Its top level imports the standard
library and `experiments.output` only; the heavy work is imported inside `main`, so that `bodyplan --help` is instant.
"""
