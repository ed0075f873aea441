"""Shared foundation of all other packages: input checks, timing, progress display, compilation and parallel work.

checks             validation of input; `InputError` names the value and what is allowed
keyword_arguments  unknown keyword arguments, and earlier names that still work
resample           block averages of images, and interpolation back to full resolution
stage_timer        wall time, rate and remaining time of the stages of a run
progress_display   progress bar with rate and time left
numba_kernel       decorators that compile functions with numba
kernel_cache       cache of compiled functions on disk
compile_notice     log message at the first compilation
processes          parallel work on this machine or on a Dask cluster
"""
