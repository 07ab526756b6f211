"""Reading of a Mitsuba XML file by Mitsuba's own parser: parameters, search folders and errors in one line."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from dasim.base import untrusted
from dasim.base.errors import InputError
from dasim.scene.mitsuba_scene import MitsubaScene

FILE_KEYS = ("filename", "file")  # properties of plugins that name files
PICTURES = ("bitmap", "envmap")  # plugins whose files are pictures
LONGEST = 300  # characters of an error message of a plugin, which may describe all of itself
_PLACE = re.compile(r"\[\w+\.(?:cpp|h|py):\d+\] ")  # in Mitsuba's source
_UNDEFINED = re.compile(r"undefined parameter: \$(\w*)")
_UNUSED = re.compile(r"unused parameters: - \$(\w+)")


@contextmanager
def search_folders(file: Path) -> Iterator[None]:
    """Find files beside an XML file, and in the folders of its ``<path>`` elements once it is parsed, in this block."""
    import mitsuba as mi

    before, resolver = mi.file_resolver(), mi.FileResolver(mi.file_resolver())
    resolver.prepend(str(file.parent))
    mi.set_file_resolver(resolver)
    try:
        yield
    finally:
        mi.set_file_resolver(before)


def parse(scene: MitsubaScene) -> tuple[Any, Any]:
    """Mitsuba's parser configuration and the parsed nodes, with absolute file names.

    Called within :func:`search_folders`, to which each ``<path>`` element adds its folder: relative to the file, else
    to the folders before it. InputError where the file or a parameter is wrong.
    """
    import mitsuba as mi

    config = mi.parser.ParserConfig(mi.variant())
    config.merge_equivalent = config.merge_meshes = False  # merging shapes would lose their names
    try:
        state = mi.parser.parse_file(config, str(scene.file), **scene.define)
        mi.parser.transform_all(config, state)
    except Exception as error:
        raise load_error(scene, error) from None
    _find_files(state.nodes, str(scene.file))
    return config, state


def instance(config: Any, state: Any, scene: MitsubaScene) -> Any:
    """Mitsuba's scene of the parsed nodes."""
    import mitsuba as mi

    try:
        result = mi.parser.instantiate(config, state)
    except Exception as error:
        message = load_error(scene, error)
        # The objects instantiated so far must be deleted: kernels of the next scene would call a light that outlives
        # its shape. The traceback refers to them as well.
        state.nodes.clear()
        error.__traceback__ = None
        raise message from None
    return result[0] if isinstance(result, list) else result


def load_error(scene: MitsubaScene, error: Exception) -> InputError:
    """Mitsuba's error message in one line, without the place in Mitsuba's source; what to try for parameters."""
    text = " ".join(str(error).split())
    if undefined := _UNDEFINED.search(text):
        name = undefined.group(1)
        return InputError(f"{scene.file}: parameter ${name} has no value and no default; give --define {name}=VALUE")
    if unused := _UNUSED.search(text):
        return InputError(f"{scene.file}: --define {unused.group(1)}: the scene has no such parameter")
    return InputError(f"{scene.file}: does not load in Mitsuba ({_PLACE.sub('', text)})")


def render_error(scene: MitsubaScene, error: Exception) -> InputError:
    """Mitsuba's error message, in one line, where a plugin cannot render what the file describes.

    The error loses its traceback, which refers to the scene (see :func:`instance`).
    """
    text = _PLACE.sub("", " ".join(str(error).split()))
    if len(text) > LONGEST:
        text = f"{text[: LONGEST // 3]} ... {text[-LONGEST // 2 :]}"
    error.__traceback__ = None
    return InputError(f"{scene.file}: does not render in Mitsuba ({text})")


def _find_files(nodes: Any, where: str) -> None:
    """Make the names of files that exist absolute, because some plugins look them up in the working folder.

    Raises InputError for anything but a regular file of limited size, on which a plugin might wait forever, and for
    pictures with more pixels than the limit.
    """
    import mitsuba as mi

    resolver = mi.file_resolver()
    for node in nodes:
        for key in FILE_KEYS:
            if key in node.props and node.props.type(key) == mi.Properties.Type.String:
                path, name = Path(str(resolver.resolve(node.props[key]))), f"{where}: file '{node.props[key]}'"
                if path.exists():
                    untrusted.check_file(path, name)
                    if node.props.plugin_name() in PICTURES:
                        untrusted.check_picture(path, name)
                    node.props[key] = str(path.absolute())
