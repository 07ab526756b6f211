"""Scores against ground truth, and the claims and studies that test the simulator and the reconstruction.

>>> import dasim, validation
>>> shot = dasim.simulate("desk", "da-mobile")
>>> print(validation.table(validation.score_map(shot.truth.depth_m, shot.capture, shot.truth)))

``dasim validate`` runs the claims (``validation/claims``), ``dasim study`` the studies (``validation/studies``). The
public names are listed in ``__init__.pyi`` and loaded on first use.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
