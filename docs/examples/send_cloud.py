"""Send the sheet's shape to a running runtime: the cloud, and the voltages of this shape untouched (V_pred).

    eitskin surface docs/examples/surface.ply --out cloud.npz
    python docs/examples/send_cloud.py cloud.npz [CONTROL]

CONTROL is the runtime's control endpoint, not the one that publishes frames; the default needs no argument. For a file
without a prediction, this program computes it, which needs the extra ``sim``.
"""

import sys
from dataclasses import replace

import eitskin
from eitskin_proto.skin.cloud_file import load_surface

if len(sys.argv) < 2:
    sys.exit(__doc__)

found = load_surface(sys.argv[1])
if found.predicted_V is None:
    from eitskin_sim.surface.predict import flat_voltages, predict

    found = replace(found, predicted_V=predict(found.cloud_mm), predicted_flat_V=flat_voltages())
revision = eitskin.send_cloud(sys.argv[2], found) if len(sys.argv) > 2 else eitskin.send_cloud(found)
print(f"cloud {revision} is in use; every frame from now on carries this number")
