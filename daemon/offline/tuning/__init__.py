"""Tuning of filters on recordings and on problems with a known answer."""
