"""Datasets: many captures with ground truth, identical bytes on one machine or many; start with ``make``."""
