"""Mends the CMake files of the ROS wheels, which name folders of the machine that built them."""

from __future__ import annotations

import re
from pathlib import Path

PYTHON_INCLUDE = re.compile(r"/opt/python/cp\d+-cp\d+t?/include/python[\d.]+t?")
NUMPY_INCLUDE = re.compile(r"/opt/python/cp\d+-cp\d+t?/lib/python[\d.]+t?/site-packages/numpy/_?core/include")


def mend_cmake_files(share: Path, python_include: str, numpy_include: str) -> int:
    """Point every exported CMake file below a folder to this machine's Python and NumPy headers.

    Files are replaced whole; doing it again changes nothing.

    Args:
        share: The ``share`` folder of the venv that holds the wheels.
        python_include: Folder of ``Python.h``.
        numpy_include: Folder of ``numpy/arrayobject.h``'s parent.

    Returns:
        How many files were changed.
    """
    changed = 0
    for path in sorted(share.glob("*/cmake/*.cmake")):
        text = path.read_text()
        if "/opt/python/" not in text:
            continue
        mended = NUMPY_INCLUDE.sub(lambda _: numpy_include, PYTHON_INCLUDE.sub(lambda _: python_include, text))
        if mended != text:
            temporary = path.with_suffix(".new")
            temporary.write_text(mended)
            temporary.replace(path)
            changed += 1
    return changed
