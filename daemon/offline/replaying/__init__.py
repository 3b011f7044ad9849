"""Recordings through the estimator again."""
