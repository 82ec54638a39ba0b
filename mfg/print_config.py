"""Settings of the slicer that follow from the catalogue: printer, filaments, and how rigid and soft interlock."""

from __future__ import annotations

import numpy as np

from mfg.catalogue import Filament, Printer
from mfg.plate import OVERHANG

# What the catalogue does not say; all (assumed), of common profiles for a 0.6 mm nozzle.
FLOW = {"rigid": 20.0, "soft": 5.0}  # most that the nozzle melts [mm3/s]
HEAT = {"rigid": (220, 60), "soft": (230, 45)}  # nozzle, bed [C]
SPEEDS = {"perimeter_speed": 150, "external_perimeter_speed": 100, "infill_speed": 200, "solid_infill_speed": 150,
          "top_solid_infill_speed": 100, "support_material_speed": 120, "bridge_speed": 50, "first_layer_speed": 40,
          "travel_speed": 400}  # fmt: skip  # [mm/s]
FILAMENT_DIAMETER = 1.75  # [mm]
BEAM_LAYERS = 2  # height of an interlocking beam
AVOIDANCE = 1  # cells between the beams and the air, so that none shows outside
_WIDTHS = ("extrusion_width", "first_layer_extrusion_width", "perimeter_extrusion_width",
           "external_perimeter_extrusion_width", "infill_extrusion_width", "solid_infill_extrusion_width",
           "top_infill_extrusion_width", "support_material_extrusion_width")  # fmt: skip


def interlocking(printer: Printer) -> dict[str, str]:
    """Settings of one object whose parts of different filament interlock; the same keys in every slicer that can.

    A slicer lays alternate beams of either filament in each cell, two beam widths wide, through which the boundary
    runs. Where it runs is a matter of chance, so with one cell a beam reaches its own width beyond the boundary on
    average, and twice as far at most. The width is therefore the printer's interlock depth, if a line can be so thin.
    The setting in millimetres, `mmu_segmented_region_interlocking_depth`, works on painted regions only, not on parts.
    """
    if printer.interlock_depth <= 0:
        return {"interlocking_beam": "0"}
    return {
        "interlocking_beam": "1",
        "interlocking_beam_width": _mm(max(printer.interlock_depth, printer.line_width)),
        "interlocking_depth": "1",
        "interlocking_beam_layer_count": str(BEAM_LAYERS),
        "interlocking_boundary_avoidance": str(AVOIDANCE),
        "interlocking_orientation": "22.5",
    }


def prusa_config(printer: Printer, rigid: Filament, soft: Filament) -> dict[str, str]:
    """Printer, filaments and print of PrusaSlicer: one nozzle for each filament, supports of the rigid one.

    Everything that is not said here is PrusaSlicer's own default.
    """
    x, y, z = (_mm(side) for side in printer.volume)
    both = (rigid, soft)
    colours = ";".join(filament.colour for filament in both)
    config = {
        "printer_technology": "FFF",
        "gcode_flavor": "marlin2",
        "printer_notes": printer.name,
        "bed_shape": f"0x0,{x}x0,{x}x{y},0x{y}",
        "max_print_height": z,
        "nozzle_diameter": _pair(printer.nozzle, printer.nozzle),
        "single_extruder_multi_material": "0",
        "wipe_tower": "0",  # one nozzle for each filament
        "filament_type": ",".join(_kind(filament) for filament in both),
        "filament_diameter": f"{FILAMENT_DIAMETER},{FILAMENT_DIAMETER}",
        "filament_density": ",".join(f"{filament.density / 1e3:.6g}" for filament in both),
        "filament_colour": colours,
        "extruder_colour": colours,
        "filament_max_volumetric_speed": f"{FLOW['rigid']},{FLOW['soft']}",
        "temperature": f"{HEAT['rigid'][0]},{HEAT['soft'][0]}",
        "first_layer_temperature": f"{HEAT['rigid'][0]},{HEAT['soft'][0]}",
        "bed_temperature": f"{HEAT['rigid'][1]},{HEAT['soft'][1]}",
        "first_layer_bed_temperature": f"{HEAT['rigid'][1]},{HEAT['soft'][1]}",
        "layer_height": _mm(printer.layer_height),
        "first_layer_height": _mm(printer.layer_height),
        "perimeters": str(rigid.walls),
        "fill_density": f"{rigid.infill:.0%}",
        "fill_pattern": rigid.infill_pattern,
        "support_material": "1",
        "support_material_auto": "1",
        "support_material_buildplate_only": "0",
        "support_material_threshold": f"{np.rad2deg(OVERHANG):.0f}",
        "support_material_style": "grid",
        "support_material_extruder": "1",
        "support_material_interface_extruder": "1",
        "support_material_interface_layers": "2",
    }
    config |= {key: _mm(printer.line_width) for key in _WIDTHS}
    config |= {key: str(speed) for key, speed in SPEEDS.items()}
    return config


def config_text(config: dict[str, str]) -> str:
    """As a 3MF file of PrusaSlicer holds it: an ini file of comments."""
    lines = [f"; {key} = {value}" for key, value in sorted(config.items())]
    return "\n".join(["; written by bodyplan", *lines, ""])


def _mm(length: float) -> str:
    return f"{1e3 * length:.6g}"


def _pair(a: float, b: float) -> str:
    return f"{_mm(a)},{_mm(b)}"


def _kind(filament: Filament) -> str:
    """PrusaSlicer's word for the family, by which it warns of wrong temperatures; FLEX is any rubber."""
    word = filament.name.split()[0].upper()
    return "FLEX" if word in ("TPU", "TPE") else word
