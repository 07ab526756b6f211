"""Datasets in the layouts of others: HDF5, COCO, BOP, NYU, Croissant, and stacks of focus and aperture."""
