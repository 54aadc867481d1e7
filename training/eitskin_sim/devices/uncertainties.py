"""How far true devices are from the nominal one: the distributions that devices are drawn from.

Bounds are of uniform draws, or of log-uniform ones where the text says so. The defaults are about what a lab can hold
without calibration: the lab mix and the mismatches of measured skins lie well inside them.
"""

from dataclasses import dataclass

Bounds = tuple[float, float]


@dataclass(frozen=True, slots=True)
class Uncertainties:
    """Distributions of what a device, its reference, its scans and its drift may be off by."""

    # A device.
    electrode_mm: Bounds = (0.0, 1.0)
    """Standard deviation of the electrodes' places along the border, of one device."""
    electrode_most_mm: float = 2.0
    """No electrode is further from its place."""
    electrode_size: Bounds = (0.8, 1.3)
    """Factor of all electrodes' sizes."""
    electrode_size_each: float = 0.05
    """Standard deviation of the logarithm of each one's, at most twice that."""
    impedance: Bounds = (0.1, 30.0)
    """Factor of all contact impedances, log-uniform."""
    impedance_each: Bounds = (0.0, 0.7)
    """Standard deviation of the logarithm of each one's, of one device."""
    layer_rms: Bounds = (0.0, 0.12)
    """Unevenness of the layer's log conductivity."""
    correlation_mm: Bounds = (25.0, 80.0)
    """Of this and of the late fields."""
    gauge_factor: Bounds = (-1.5, 1.5)
    """Conductivity goes with (local area stretch)^-k."""

    # Its reference.
    reference_flat: float = 0.5
    """Share of references that are taken of the flat sheet, neither stretched nor bent."""
    reference_stretch: Bounds = (0.0, 0.03)
    """By how much the others are stretched, along and across."""

    # What came after the reference.
    drift: Bounds = (0.002, 0.023)
    """Standard deviation of a sample's common log factor, log-uniform: 1 to 300 presses of measured skins."""
    drift_wild: float = 0.03
    """Share of samples whose drift has a deviation of ``drift_wild_sd``."""
    drift_wild_sd: float = 0.12
    drift_most: float = 0.3
    """No sample's common log factor is further from 0."""
    late_even: float = 0.3
    """Share of deformations without uneven drift."""
    late_gradient_rms: Bounds = (0.002, 0.03)
    """Of the others' tilts of log conductivity, log-uniform."""
    late_field_rms: Bounds = (0.002, 0.04)
    """Of the others' smooth fields of log conductivity, log-uniform."""

    # The scan.
    scan_noise_mm: Bounds = (0.1, 2.0)
    """Noise of every coordinate of a scan, log-uniform."""
    scan_scale: float = 0.004
    """Standard deviation of the relative error of a scan's scale."""
    scan_stale: Bounds = (-0.05, 0.05)
    """By which share of the whole deformation a scan is behind, or ahead of, the sheet."""

    # Its front end.
    front_end: float = 0.7
    """Share of devices whose electronics are not ideal; the others' gains alone are off."""
    gain: float = 0.01
    """Standard deviation of each pair's gain."""
    paths: float = 0.003
    """Standard deviation of the gains of the paths of V+ and V-."""
    sink: float = 0.004
    """Standard deviation of the sink's current over the source's, common to all drives."""
    sink_each: float = 0.001
    """Of each drive's besides."""
    leak_S: Bounds = (1e-7, 1e-5)
    """Conductance from each terminal to ground, log-uniform."""
    stray_S: Bounds = (6e-7, 2e-5)
    """Susceptance likewise: 5 to 160 pF at 20 kHz."""
    stray_each: float = 0.3
    """Standard deviation of the logarithm of each terminal's of both."""
    offset_V: Bounds = (1e-3, 3e-2)
    """Standard deviation of the offsets of drives and of pairs, under 1 A, log-uniform; the weakest row has 0.3 V."""
    divided: float = 0.5
    """Share of front ends that divide what they read by the current that returns."""
