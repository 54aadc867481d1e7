"""Tell a running runtime how the sheet is bent: the cloud, and what it should read untouched (V_pred).

    eitskin surface docs/examples/surface.ply --out cloud.npz --predict
    python docs/examples/send_cloud.py cloud.npz [CONTROL]

CONTROL is the runtime's control endpoint, not the one it publishes on. A file without a prediction gets one here, which
needs the extra ``sim``, for the forward model.
"""

import sys

import numpy as np

import eitskin
from eitskin.messaging.endpoints import default_control

with np.load(sys.argv[1]) as file:
    surface = {name: file[name] for name in ("cloud", "predicted", "predicted_flat") if name in file}
if "predicted" not in surface:
    from eitskin_sim.surface.predict import flat_voltages, predict

    surface |= {"predicted": predict(surface["cloud"]), "predicted_flat": flat_voltages()}
control = sys.argv[2] if len(sys.argv) > 2 else default_control()
revision = eitskin.send_cloud(control, **surface)
print(f"cloud {revision} is in use; every frame from now on carries this number")
