"""Whether every link within the built site leads to a file: `python docs/links.py build/docs`, as `make docs` does."""

import os
import re
import sys
from pathlib import Path
from urllib.parse import unquote


def broken(site: Path) -> list[str]:
    """Page and target of each link, picture, script or style sheet that is not there."""
    found = set()
    for page in sorted(site.rglob("*.html")):
        for target in re.findall(r'(?:href|src)="([^"#?]+)', page.read_text(encoding="utf-8")):
            if not re.match(r"[a-z]+:|//", target) and not os.path.exists(page.parent / unquote(target)):
                found.add(f"{page.relative_to(site)}: {target}")
    return sorted(found)


if __name__ == "__main__":
    sys.exit("\n".join(broken(Path(sys.argv[1]))) or None)
