"""``eitskin curves``: the losses of several training runs side by side, as a picture and as a table."""

import argparse
import json
from pathlib import Path


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add what the subcommand takes."""
    parser.add_argument("runs", nargs="+", metavar="RUN", help="folders of 'eitskin train', finished or not")
    parser.add_argument("--plot", metavar="FILE.png", help="draw them")
    parser.add_argument("--json", action="store_true", help="print one JSON object")


def run(arguments: argparse.Namespace) -> int:
    """Read, draw and print."""
    from eitskin_tools.command_line import files
    from eitskin_tools.errors import UsageError
    from eitskin_training import curves

    if arguments.plot:
        files.picture(arguments.plot)
    folders = [Path(name) for name in arguments.runs]
    if len({folder.resolve() for folder in folders}) < len(folders):
        raise UsageError("the same run is named twice")
    names = [folder.name for folder in folders]
    keys = names if len(set(names)) == len(names) else [str(folder) for folder in folders]
    histories = {key: curves.history_of(folder) for key, folder in zip(keys, folders, strict=True)}
    if arguments.plot:
        curves.compare(histories, Path(arguments.plot))
    found = []
    for name, history in histories.items():
        best = min(history, key=lambda epoch: epoch.validation_loss)
        found.append(
            {
                "run": name,
                "epochs": len(history),
                "best_epoch": best.number,
                "validation_loss": round(best.validation_loss, 6),
                "validation_cc": round(best.validation_cc, 4),
                "training_loss": round(best.training_loss, 6),
                "seconds": round(sum(epoch.seconds for epoch in history), 1),
            }
        )
    if arguments.json:
        print(json.dumps({"runs": found, "plot": arguments.plot}))
        return 0
    for row in found:
        print(
            f"{row['run']}: best epoch {row['best_epoch']} of {row['epochs']}, validation loss "
            f"{row['validation_loss']:.5f}, CC {row['validation_cc']:.4f}; training loss {row['training_loss']:.5f}, "
            f"{row['seconds']:.0f} s"
        )
    return 0
