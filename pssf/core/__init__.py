"""Provide input checks, timing, progress display, compilation and parallel work for all other subpackages.

checks             validation of input; `InputError` names the value and the allowed values
keyword_arguments  rejection of unknown keyword arguments, and replacement of former names
label_names        names of the contour landmarks and positions of JSW(x)
resample           block averages of images, and interpolation back to full resolution
stage_timer        wall time, rate and remaining time of the stages of a run
progress_display   progress bar with rate and remaining time
numba_kernel       decorators that compile functions with numba
kernel_cache       cache of compiled functions on disk
compile_notice     log message at the first compilation
processes          parallel work on this machine or on a Dask cluster
"""
