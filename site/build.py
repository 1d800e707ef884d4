"""Build the site: python site/build.py. It writes _build/pages and, from them, _build/html."""

import shutil
import sys
from pathlib import Path

FOLDER = Path(__file__).parent
sys.path.insert(0, str(FOLDER))
import pages  # noqa: E402
from sphinx.cmd.build import main as sphinx  # noqa: E402

from gbdqn_ref.__main__ import Parser, program  # noqa: E402

BUILT = FOLDER / "_build"


def main():
    """Everything anew, with every warning as an error; the exit status is Sphinx's."""
    Parser(description="Build the site.").parse_args()
    shutil.rmtree(BUILT, ignore_errors=True)
    pages.write(BUILT / "pages", BUILT / "extra")
    folders = [str(BUILT / "pages"), str(BUILT / "html"), "-d", str(BUILT / "trees")]
    status = sphinx(["-W", "--keep-going", "-q", "-c", str(FOLDER), *folders])
    if status == 0:
        print(f"open {BUILT / 'html/index.html'}")
    return status


if __name__ == "__main__":
    program(main)
