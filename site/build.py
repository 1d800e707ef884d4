"""Build the site: python site/build.py. It writes _build/pages and, from them, _build/html."""

import shutil
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER))
import pages  # noqa: E402
from sphinx.cmd.build import main as sphinx  # noqa: E402

BUILT = FOLDER / "_build"


def main():
    """Every warning is an error; the exit status is Sphinx's."""
    pages.write(BUILT / "pages", BUILT / "extra")
    (FOLDER / "figures").mkdir(exist_ok=True)
    folders = [str(BUILT / "pages"), str(BUILT / "html"), "-d", str(BUILT / "trees")]
    status = sphinx(["-W", "--keep-going", "-q", "-c", str(FOLDER), *folders])
    if status:
        shutil.rmtree(BUILT / "trees")  # or the next build would not warn again
    else:
        print(f"open {BUILT / 'html/index.html'}")
    return status


if __name__ == "__main__":
    sys.exit(main())
