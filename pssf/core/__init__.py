"""What every other part stands on: checks of input, a timer, progress, work on many processes.

checks    refusals: the thing, its value, what is allowed
timer     seconds of stages, and how fast they go
progress  a bar, rate and time left
execution who does the work of a run, and what shows it
compile_notice  a line of log where kernels have to be compiled
blocks    means of blocks of a map, and back
workers   what every worker process keeps to
parallel  work on processes whose results do not depend on how many there are
cluster   the same on a Dask scheduler's workers  (extra "cluster")
"""
