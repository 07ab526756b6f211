"""Refuses a site that would ask another host for a script, a style, a font or a picture."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

IN_PAGES = re.compile(
    r"<(?:script|img|iframe|source|video|audio|embed|object)\b[^>]*?\s(?:src|srcset|data)=[\"']?(?:https?:)?//[^>]*>"
    r"|<link\b(?=[^>]*rel=[\"']?(?:stylesheet|preload|preconnect|icon|dns-prefetch))[^>]*href=[\"']?(?:https?:)?//[^>]*>",
    re.IGNORECASE,
)
IN_STYLES = re.compile(r"(?:url\(|@import)\s*[\"']?(?:https?:)?//[^)\"';]*", re.IGNORECASE)


def requests(site: Path) -> list[str]:
    """What the pages and styles of a site would load from elsewhere, each with its file."""
    found = []
    for path in sorted(site.rglob("*")):
        patterns = {".html": (IN_PAGES, IN_STYLES), ".css": (IN_STYLES,)}.get(path.suffix, ())
        text = path.read_text(encoding="utf-8") if patterns else ""
        found += [f"{path.relative_to(site)}: {match[0]}" for pattern in patterns for match in pattern.finditer(text)]
    return found


def on_post_build(config: Any) -> None:
    """Hook of MkDocs: end the build where the site is not whole on its own."""
    from mkdocs.exceptions import PluginError

    if found := requests(Path(config.site_dir)):
        raise PluginError("requests to other hosts:\n" + "\n".join(found))
