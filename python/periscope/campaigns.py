"""Runs of campaigns, and their result folders."""

from __future__ import annotations

import html
import json
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Union

from . import labelled, plots
from ._periscope import Results as Folder, Table, design_json, run as run_pipeline
from .progress import Bar, is_watched

__all__ = ["Results", "design", "run"]

StrPath = Union[str, "os.PathLike[str]"]

REASONS = 6
"""Reasons of a verdict that a notebook shows at most."""


class Results(Folder):
    """A result folder: a mapping of table names to tables.

    Parameters
    ----------
    path : str or os.PathLike
        The folder that a run wrote.

    Raises
    ------
    ResultsError
        If it is no result folder.
    """

    def __iter__(self) -> Iterator[str]:
        return iter(self.tables)

    def __len__(self) -> int:
        return len(self.tables)

    def __contains__(self, name: object) -> bool:
        return name in self.tables

    @property
    def patches(self) -> Table:
        """The table `patches`: positions with standard deviations."""
        return self["patches"]

    def explain(
        self,
        *,
        patch: int | None = None,
        distance: tuple[int, int] | None = None,
        onset: tuple[str, int, int, int] | None = None,
        echo: tuple[str, int, int] | None = None,
        table: str | None = None,
        campaign: Sequence[StrPath] = (),
    ) -> dict[str, Any]:
        """Origins of a row, back to the raw files.

        Parameters
        ----------
        patch : int, optional
            Explain this patch.
        distance : (int, int), optional
            Explain the distance of these patches.
        onset : (str, int, int, int), optional
            Explain this onset: sensor, lit patch, seen patch, rank.
        echo : (str, int, int), optional
            Explain this echo of a lidar: run (its raw file), pulse, echo.
        table : str, optional
            Table, if several have such rows; by default the last one of the dataflow.
        campaign : sequence of paths
            Campaign folders, if they have moved since the run.

        Returns
        -------
        dict
            What `periscope explain --format json` prints; its `--help` lists the keys.

        Raises
        ------
        ValueError
            Unless exactly one row is named.
        ResultsError
            If there is no such row.
        """
        named = [
            f"{kind}={value}"
            for kind, value in (
                ("patch", patch),
                ("distance", distance and ",".join(map(str, distance))),
                ("onset", onset and ",".join(map(str, onset))),
                ("echo", echo and ",".join(map(str, echo))),
            )
            if value is not None
        ]
        if len(named) != 1:
            forms = "patch=3, distance=(3, 4), onset=('s1', 3, 4, 2) or echo=('raw/strip1.pls', 17, 1)"
            raise ValueError(f"name one row: {forms}")
        return json.loads(self.explain_json(named[0], table, list(campaign)))

    def report(self, to: StrPath | None = None) -> Path:
        """Writes the report, one HTML page that needs no network.

        Parameters
        ----------
        to : str or os.PathLike, optional
            File; by default report.html in the result folder.

        Returns
        -------
        pathlib.Path
            The file.
        """
        file = Path(to) if to is not None else self.path / "report.html"
        file.write_text(self.report_html(), encoding="utf-8")
        return file

    def __repr__(self) -> str:
        return f"<Results in {self.path}: {', '.join(self.tables)}>"

    def _repr_html_(self) -> str:
        """The verdict, the picture of the scene, and the tables, for notebooks."""
        word, reasons = self.verdict
        listed = "".join(f"<li>{html.escape(reason)}</li>" for reason in reasons[:REASONS])
        row = "<tr><td>{}</td><td>{}</td></tr>".format
        rows = "".join(row(html.escape(name), len(self[name])) for name in self)
        return (
            f"<p>Results in {html.escape(str(self.path))}: <strong>{html.escape(word)}</strong></p><ul>{listed}</ul>"
            f"{dict(self.figures()).get('scene', '')}"
            f"<details><summary>{len(self)} tables</summary>"
            f"<table><tr><th>table</th><th>rows</th></tr>{rows}</table></details>"
        )

    def to_xarray(self, sensor: str | None = None) -> Any:
        """The profiles of the scene as a labelled array. Needs xarray.

        Parameters
        ----------
        sensor : str, optional
            Sensor; needed where there are several.

        Returns
        -------
        xarray.Dataset
            ``mean_v``, ``se_v`` and, of photon counters, ``counts`` over (lit, seen, time), NaN where there are none;
            ``shots`` and ``noise_v`` over (lit, seen). The coordinate ``time_ps`` is after the reference pulse, else
            the trigger; it has the axes (lit, seen, time) where profiles are not on one grid.

        Raises
        ------
        ImportError
            Without xarray.
        ValueError
            If several profiles belong to one pair of patches.
        """
        return labelled.dataset(self["profiles"], sensor)

    def plot(self, ax: Any = None) -> Any:
        """Draws the patches in space, and points of hidden surfaces. Needs matplotlib.

        Parameters
        ----------
        ax : mpl_toolkits.mplot3d.Axes3D, optional
            Where to; by default a new figure.

        Returns
        -------
        mpl_toolkits.mplot3d.Axes3D
        """
        return plots.results(self, ax)


def run(
    campaign: StrPath | Sequence[StrPath],
    pipeline: StrPath | None = None,
    out: StrPath | None = None,
    set: Mapping[str, object] | None = None,
    *,
    until: str | None = None,
    progress: Literal["auto", "tqdm", "bar", "lines", "none"] = "auto",
) -> Results:
    """Runs a pipeline over campaigns. What is already computed is reused; Ctrl-C keeps what is finished.

    Tables are byte for byte those of `periscope run`.

    Parameters
    ----------
    campaign : str, os.PathLike, or sequence of these
        Folders with a campaign.toml.
    pipeline : str or os.PathLike, optional
        Name that `periscope pipelines` lists, or a file; by default "scene", or the pipeline for what campaign.toml
        declares.
    out : str or os.PathLike, optional
        Result folder; by default ``<campaign>-results`` next to the campaign.
    set : mapping, optional
        Parameters of the pipeline, such as ``{"onsets.threshold_sigma": 6}``.
    until : str, optional
        Stop after this table.
    progress : {"auto", "tqdm", "bar", "lines", "none"}
        How progress is shown: "auto" is a bar of tqdm in notebooks and on terminals, if tqdm is installed, else the
        program's own "bar" on a terminal, and "lines" on standard error elsewhere.

    Returns
    -------
    Results

    Warns
    -----
    UserWarning
        For each cause for which captures were left out, and if records were rejected: the table `rejects` lists them.

    Raises
    ------
    CampaignError, PipelineError, ResultsError, RunError
        If the campaign, the pipeline or the result folder is wrong, or a stage cannot go on.
    """
    one = isinstance(campaign, (str, os.PathLike))
    campaigns: list[StrPath] = [campaign] if one else list(campaign)
    if out is None:
        if len(campaigns) != 1:
            raise ValueError(f"{len(campaigns)} campaigns make one result folder; give it as `out`")
        out = _next_to(Path(campaigns[0]))
    # Scalars and lists have the same text in JSON as in TOML.
    settings = [f"{name}={json.dumps(value)}" for name, value in (set or {}).items()]
    bar = Bar() if progress == "tqdm" or (progress == "auto" and is_watched()) else None
    try:
        rejects, left_out = run_pipeline(campaigns, out, pipeline, settings, until, progress, bar)
    finally:
        if bar is not None:
            bar.close()
    for cause in left_out:
        warnings.warn(cause, stacklevel=2)
    if rejects:
        warnings.warn(f"{rejects} records were rejected; the table `rejects` says why", stacklevel=2)
    return Results(out)


def _next_to(campaign: Path) -> Path:
    """The folder next to a campaign for its results."""
    place = campaign if campaign.name not in ("", "..") else campaign.resolve()
    return place.with_name(f"{place.name}-results")


def design(scene: StrPath, *, bounces: int | None = None, threshold_sigma: float = 5.0) -> Any:
    """What a planned measurement can show: by the Cramer-Rao bound of its scene, or of a relay wall by its estimators.

    Parameters
    ----------
    scene : str or os.PathLike
        Scene description (TOML), as for `simulate`; or a wall and its surfaces (`[wall]`, `[surfaces.NAME]`).
    bounces : int, optional
        Highest order of bounces that the geometry uses, 1 to 5; by default 2, or 3 where the scene has hidden patches.
        Not for a wall.
    threshold_sigma : float
        Signal-to-noise ratio from which a pulse, or first light, counts as an onset.

    Returns
    -------
    dict or list of dict
        What `periscope design --format json` prints. A dict for a scene: precision and chance of each patch, bounces by
        their strength, pulses that blend, what the data leave open, and what changes would bring. A list for a wall,
        with a dict for each surface: points by kind, median standard deviations, nodes of its mesh, and the share of it
        that the wall can see.

    Raises
    ------
    CampaignError
        If the scene contradicts itself.

    See Also
    --------
    bounds : the bound itself, as arrays.
    """
    return json.loads(design_json(scene, bounces, threshold_sigma))
