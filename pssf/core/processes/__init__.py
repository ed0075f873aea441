"""Parallel work: processes of this machine, workers of a Dask cluster, and one process in the background.

execution           who does the work of a run, and how progress is shown
parallel_map        map a function over items on several processes, with results that do not depend on their number
cluster             the same on the workers of a Dask scheduler  (extra "cluster")
worker_processes    thread and memory settings of a worker process
child_processes     start Python processes that ignore files of the working folder
background_process  run a function in one more process meanwhile
"""
