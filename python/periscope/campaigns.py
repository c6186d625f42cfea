"""Runs of campaigns, and their result folders."""

from __future__ import annotations

import html
import json
import os
import warnings
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal, Union

from ._periscope import Results as Folder, Table, run as run_pipeline

__all__ = ["Results", "run"]

StrPath = Union[str, "os.PathLike[str]"]


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
            )
            if value is not None
        ]
        if len(named) != 1:
            raise ValueError("name one row: patch=3, distance=(3, 4) or onset=('s1', 3, 4, 2)")
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
        """The tables, and the picture of the scene, for notebooks."""
        row = "<tr><td>{}</td><td>{}</td></tr>".format
        rows = "".join(row(html.escape(name), len(self[name])) for name in self)
        picture = dict(self.figures()).get("scene", "")
        head = f"<p>Results in {html.escape(str(self.path))}</p>"
        return f"{head}<table><tr><th>table</th><th>rows</th></tr>{rows}</table>{picture}"


def run(
    campaign: StrPath | Sequence[StrPath],
    pipeline: StrPath | None = None,
    out: StrPath | None = None,
    set: Mapping[str, object] | None = None,
    *,
    until: str | None = None,
    progress: Literal["auto", "bar", "lines", "none"] = "auto",
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
    progress : {"auto", "bar", "lines", "none"}
        How progress is shown on standard error: "auto" is a bar on a terminal, lines elsewhere.

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
    rejects, left_out = run_pipeline(campaigns, out, pipeline, settings, until, progress)
    for cause in left_out:
        warnings.warn(cause, stacklevel=2)
    if rejects:
        warnings.warn(f"{rejects} records were rejected; the table `rejects` says why", stacklevel=2)
    return Results(out)


def _next_to(campaign: Path) -> Path:
    """The folder next to a campaign for its results."""
    place = campaign if campaign.name not in ("", "..") else campaign.resolve()
    return place.with_name(f"{place.name}-results")
