"""Physical simulation of dual-aperture cameras.

>>> import dasim
>>> scene = dasim.load_scene("desk")
>>> camera = dasim.focused(dasim.load_camera("da-mobile"), scene)
>>> shot = dasim.simulate(scene, camera, seed=0)

The public names stand in ``__init__.pyi`` and are loaded on first use: ``import dasim`` alone loads no Mitsuba.
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
