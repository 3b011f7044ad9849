"""The application: settings, event loop, recorder, replay, commands."""

import os

# Small matrices only: a second BLAS thread would spin beside the acquisition thread and gain nothing.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
