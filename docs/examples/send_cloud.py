"""Tell a running runtime how the sheet is bent: the scanned cloud, and what it should read untouched (V_pred).

    eitskin surface docs/examples/surface.ply --out cloud.npz
    python docs/examples/send_cloud.py cloud.npz [CONTROL]

CONTROL is the runtime's control endpoint, not the one it publishes on. Needs the extra ``sim``, for the forward model.
"""

import sys

import eitskin
from eitskin.messaging.endpoints import default_control
from eitskin_sim.surface.ordered_cloud import load_cloud
from eitskin_sim.surface.predict import flat_voltages, predict

cloud = load_cloud(sys.argv[1])  # (3, 30, 45) mm
control = sys.argv[2] if len(sys.argv) > 2 else default_control()
revision = eitskin.send_cloud(control, cloud, predicted=predict(cloud), predicted_flat=flat_voltages())
print(f"cloud {revision} is in use; every frame from now on carries this number")
