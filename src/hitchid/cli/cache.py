"""User cache of finished searches."""

from dataclasses import replace
from typing import TYPE_CHECKING

from hitchid._support.compilation import cache_folder

if TYPE_CHECKING:
    from hitchid.estimation import SearchComparison


def with_search_cache(comparison: "SearchComparison | None") -> "SearchComparison | None":
    """Return a comparison that caches finished searches for the user, to resume a stopped run."""
    from hitchid._support.checkpoints import Checkpoints

    return comparison and replace(comparison, checkpoints=Checkpoints(cache_folder() / "searches"))
