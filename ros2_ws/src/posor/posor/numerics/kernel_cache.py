"""Where numba keeps the machine code of the kernels. Only numba imports this module (see ``compiled``)."""

from __future__ import annotations

from pathlib import Path

from numba.core.caching import UserProvidedCacheLocator

from posor.numerics.compiled import PACKAGE


class KernelCacheLocator(UserProvidedCacheLocator):
    """Keeps the code by folder within this package, not by absolute path: copies of the package share one cache."""

    @classmethod
    def get_suitable_cache_subpath(cls, py_file: str) -> str:
        """Return the folder in the cache for the kernels of a file; files outside this package as numba does."""
        folder = Path(py_file).resolve().parent
        if folder.is_relative_to(PACKAGE):
            return str(folder.relative_to(PACKAGE))
        return str(super().get_suitable_cache_subpath(py_file))  # type: ignore[no-untyped-call]  # of numba
