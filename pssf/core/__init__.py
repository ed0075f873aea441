"""What every other part stands on: checks of input, a timer, progress, work on many processes.

checks    refusals: the thing, its value, what is allowed
timer     seconds of stages
progress  a bar, rate and time left
blocks    means of blocks of a map, and back
parallel  work on processes whose results do not depend on how many there are
cluster   the same on a Dask scheduler's workers  (extra "cluster")
"""
