"""Pictures with matplotlib, where it is installed. The methods `plot` call these functions."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .optional import need

if TYPE_CHECKING:
    from ._periscope import Mean, Pulses, Waveform
    from .campaigns import Results

__all__ = ["mean", "pulses", "results", "waveform"]

COLOURS = {"visible": "tab:gray", "hidden": "tab:orange", "mirror": "tab:blue"}


def axes(ax: Any, **how: Any) -> Any:
    """The given axes, or those of a new figure."""
    pyplot = need("matplotlib.pyplot", "plot")
    return ax if ax is not None else pyplot.figure(layout="constrained").add_subplot(**how)


def waveform(one: Waveform, ax: Any = None) -> Any:
    """Samples over time; over their number where the file has no time base."""
    ax = axes(ax)
    if one.dt_ps is None or one.t0_ps is None:
        ax.plot(one.volts())
        ax.set_xlabel("sample")
    else:
        ax.plot(one.time_ps() / 1000.0, one.volts())
        ax.set_xlabel("time after the trigger (ns)")
    ax.set_ylabel(f"{one.channel or 'samples'} ({one.unit or 'codes'})")
    return ax


def mean(one: Mean, ax: Any = None) -> Any:
    """The mean over time; over the number of its samples where `average` got no `dt_ps`."""
    ax = axes(ax)
    label = f"mean of {one.shots} shots"
    if one.dt_ps is None:
        ax.plot(one.values, label=label)
        ax.set_xlabel("sample")
    else:
        ax.plot((one.t0_ps + np.arange(len(one.values)) * one.dt_ps) / 1000.0, one.values, label=label)
        ax.set_xlabel("time (ns)")
    ax.set_ylabel(label)
    return ax


def pulses(one: Pulses, ax: Any = None) -> Any:
    """A line for each pulse, as high as its amplitude, with bars of one standard deviation."""
    ax = axes(ax)
    time_ns = one.time_ps / 1000.0
    ax.vlines(time_ns, 0.0, one.amplitude, colors="tab:orange")
    ax.errorbar(
        time_ns, one.amplitude, yerr=one.amplitude_sd, xerr=one.time_sd_ps / 1000.0, fmt="o", color="tab:orange"
    )
    ax.axhline(0.0, color="tab:gray", linewidth=0.5)
    ax.set_xlabel("time (ns)")
    ax.set_ylabel("amplitude")
    return ax


def results(one: Results, ax: Any = None) -> Any:
    """Patches of the best solution in space, and points of hidden surfaces; the verdict is the title."""
    ax = axes(ax, projection="3d")
    for name in ("surface", "shapes.points"):
        if name in one and len(one[name]):
            ax.scatter(*(one[name][column] for column in ("x_m", "y_m", "z_m")), c=1000.0 * one[name]["sd_m"], s=4)
    if "patches" in one:
        patches = one.patches
        best = patches["alternative"] == 0
        points_m: Any = np.stack([patches[column][best] for column in ("x_m", "y_m", "z_m")], axis=1)
        kinds: Any = patches["kind"][best]
        for kind in sorted(set(kinds)):
            ax.scatter(*np.transpose(points_m[kinds == kind]), color=COLOURS.get(kind, "tab:gray"), label=kind)
        if len(points_m) <= 64:
            for number, point_m in zip(patches["patch"][best], points_m):
                ax.text(*point_m, f" {number}", fontsize="small")
        ax.legend()
    ax.set(xlabel="x (m)", ylabel="y (m)", zlabel="z (m)", title=one.verdict[0], aspect="equal")
    return ax
