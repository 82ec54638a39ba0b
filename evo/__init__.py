"""Evolution: ask for latents, evaluate them in worker processes, tell the optimiser their order.

`cma_es` asks and tells, `evaluate` measures one candidate, `fitness` orders what was measured, `pool` runs
evaluations in processes that may die, `record` keeps every one of them, `loop` joins these and resumes exactly, and
`finals` picks the winner on its built twin. Nothing heavy is imported here.
"""
