"""Run work in parallel, in local processes or on the workers of a Dask cluster.

execution           number of processes or scheduler, progress display and timer of a run
parallel_map        map a function over items in several processes; their number does not affect the results
cluster             map a function over items on the workers of a Dask scheduler  (extra "cluster")
worker_processes    thread and memory settings of a worker process
child_processes     start Python processes that ignore files of the working folder
"""
