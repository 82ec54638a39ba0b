"""`bodyplan sample`: latents drawn from the prior become designs and one picture of them all."""

from __future__ import annotations

import argparse
from pathlib import Path

from experiments.output import DONE, PRIORS, add_decoder_option, count, emit, make_folder, progress, say, seed

HELP = "latent samples become designs (*.npz) and a contact sheet"

PICTURE = (320, 240)  # of one body [pixel]
COLUMNS = 4
BATCH = 32  # bodies decoded together; it changes no body
MOST_PICTURES = 64  # a sheet of more is no longer looked at


def configure(parser: argparse.ArgumentParser) -> None:
    """Add the arguments of this command."""
    parser.add_argument("-n", type=count, default=8, help="how many bodies (8)")
    parser.add_argument("--seed", type=seed, default=0, help="seed of the draw (0)")
    parser.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder to write to")
    add_decoder_option(parser)
    parser.add_argument("--prior", choices=PRIORS, default="normal", help="law of the latents (normal)")
    parser.add_argument("--json", action="store_true", help="print one JSON document")


def main(args: argparse.Namespace) -> int:
    """Draw, decode, write; file k depends on the seed and on k only, not on how many are drawn."""
    import json

    import numpy as np

    from decoder.latent import decoder_digest, make_decoder, sample_latents
    from mfg.picture import contact_sheet, picture_of_design
    from mfg.render import save_png

    decoder = make_decoder(args.decoder)
    folder = make_folder(args.out)
    latents = sample_latents(args.n, np.random.default_rng(args.seed), args.prior)
    digits = len(str(args.n - 1))
    bodies, images, labels = [], [], []
    designs = (design for k in range(0, args.n, BATCH) for design in decoder.decode(latents[k : k + BATCH]))
    for k, design in enumerate(progress(designs, args.n, "decoding and drawing")):
        file = folder / f"body_{k:0{digits}d}.npz"
        design.save(file)
        bodies.append({"file": file.name, "design": design.key, "segments": len(design.segments),
                       "joints": len(design.joints)})  # fmt: skip
        if k < MOST_PICTURES:
            images.append(picture_of_design(design, PICTURE))
            labels.append(f"{file.stem}   {_counted(len(design.segments), 'segment')}, "
                          f"{_counted(len(design.joints), 'joint')}")  # fmt: skip
    np.save(folder / "latents.npy", latents)
    save_png(folder / "sheet.png", contact_sheet(images, labels, min(COLUMNS, len(images))))
    result = {"n": args.n, "seed": args.seed, "decoder": args.decoder, "decoder_digest": decoder_digest(decoder),
              "prior": args.prior, "out": str(folder), "sheet": "sheet.png", "latents": "latents.npy",
              "bodies": bodies}  # fmt: skip
    (folder / "sample.json").write_text(json.dumps(result, indent=2) + "\n", "utf-8")
    others = sorted({p.name for p in folder.glob("body_*.npz")} - {str(b["file"]) for b in bodies})
    if others:
        say(f"note: {folder} also holds {len(others)} bodies of an earlier sample, {others[0]} for one")
    if args.n > MOST_PICTURES:
        say(f"note: the contact sheet shows the first {MOST_PICTURES}")
    if args.json:
        emit(result)
    else:
        print(f"{args.n} bodies in {folder}; look at {folder / 'sheet.png'}, then: bodyplan score {folder}/*.npz")
    return DONE


def _counted(number: int, what: str) -> str:
    return f"{number} {what}{'s' * (number != 1)}"
