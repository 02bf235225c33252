"""Words that the command line knows, so that none of what they stand for must be loaded for it."""

from typing import Literal

CloudKind = Literal["sparse", "sparse_noisy", "stereo_pair_sparse", "stereo_dense"]
RecipeOption = Literal["paper", "full", "both"]
_Courts = Literal["colonnade", "corridor", "courtyard2", "courtyard4", "facade"]
PlanName = Literal[_Courts, "halls", "halls_apart", "mirror", "weak"]
