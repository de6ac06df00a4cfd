"""Natural blur of a scene of planes

A scene with a depth map is divided into planes; the image for each focal plane is what an eye with a small pupil sees
in incoherent light. These images serve as targets of holograms.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import slice_rgbd_targets
from odak.learn.tools import load_image
from odak.learn.wave import incoherent_focal_stack_rgbd

assets = files("odak") / "assets"
scene = load_image(assets / "scene.png", torch_style=True)
scene = scene[:3, :, 420:1500]
depth = load_image(assets / "scene_depth.png").float()[:, 420:1500]
scene = torch.nn.functional.interpolate(scene[None].float(), (256, 256), mode="area")[0]
depth = torch.nn.functional.interpolate(depth[None, None], (256, 256), mode="area")[
    0, 0
]
positions = torch.linspace(0, 1, 5)
targets, masks = slice_rgbd_targets(scene, depth / depth.max(), positions)
stack = incoherent_focal_stack_rgbd(
    targets, masks, 8e-3 * positions, 8e-6, [639e-9, 515e-9, 473e-9]
)

# %%
figure, axes = plt.subplots(1, 4, figsize=(13, 3.6))
drawn = axes[0].imshow(depth, cmap="viridis")
figure.colorbar(drawn, ax=axes[0], label="depth (0 near, 1 far)", shrink=0.8)
axes[0].set_title("depth")
for axis, index, title in zip(axes[1:], (0, 1, 3), ("first", "second", "last")):
    axis.imshow(stack[index].permute(1, 2, 0).clamp(0, 1))
    axis.set_title(f"focus on the {title} plane")
for axis in axes:
    axis.axis("off")
# Thumbnail: 0.37
# Picture: Depth of a scene, and three images of it with the focus at different depths
plt.show()
