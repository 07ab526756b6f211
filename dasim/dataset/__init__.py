"""Datasets: many captures with their truth, the same bytes on one machine or many."""
