"""Periscope: time-of-flight waveforms from scope files to coordinates with error bars.

Reading: `read`. Shots to a profile: `average`, `estimate_noise`, `estimate_response`, `correct_pile_up`. Pulses:
`deconvolve`, `deconvolve_counts`. Geometry: `t2_distances`, `t3_ranges`, `complete_distances`, `classical_scaling`,
`iso_embed`, `smacof`, `solve_positions`. Campaigns: `write_campaign`, `simulate`, `run`, `Results`. Exceptions:
`periscope.errors`.

Times are picoseconds, lengths metres; names carry the unit. Sample n of a record lies at ``t0_ps + n * dt_ps``.
"""

from . import errors
from ._periscope import (
    VERSION as __version__,
    Distances,
    Mean,
    Noise,
    Positions,
    Pulses,
    Ranges,
    Response,
    ResponseEstimate,
    Table,
    Waveform,
    Waveforms,
    autoregressive_acf,
    average,
    classical_scaling,
    complete_distances,
    correct_pile_up,
    deconvolve,
    deconvolve_counts,
    estimate_noise,
    estimate_response,
    iso_embed,
    quietest,
    read,
    simulate,
    smacof,
    solve_positions,
    t2_distances,
    t3_ranges,
)
from .campaigns import Results, run
from .errors import (
    CampaignError,
    FormatError,
    PeriscopeError,
    PipelineError,
    ResultsError,
    RunError,
    UndeterminedError,
)
from .recordings import write_campaign

__all__ = [
    "CampaignError",
    "Distances",
    "FormatError",
    "Mean",
    "Noise",
    "PeriscopeError",
    "PipelineError",
    "Positions",
    "Pulses",
    "Ranges",
    "Response",
    "ResponseEstimate",
    "Results",
    "ResultsError",
    "RunError",
    "Table",
    "UndeterminedError",
    "Waveform",
    "Waveforms",
    "__version__",
    "autoregressive_acf",
    "average",
    "classical_scaling",
    "complete_distances",
    "correct_pile_up",
    "deconvolve",
    "deconvolve_counts",
    "errors",
    "estimate_noise",
    "estimate_response",
    "iso_embed",
    "quietest",
    "read",
    "run",
    "simulate",
    "smacof",
    "solve_positions",
    "t2_distances",
    "t3_ranges",
    "write_campaign",
]
