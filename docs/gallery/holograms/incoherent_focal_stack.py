"""Natural blur of a scene of planes

A hologram with depth needs targets that are out of focus in the right way. In incoherent light each plane of a scene is
blurred by its distance from the focus, and near planes cover far ones: this is what an eye with a small pupil sees, and
what a display should show.

[Multiplane and multi-colour holograms](../../guides/multiplane_and_colour.md) uses such stacks.
"""

from importlib.resources import files

import matplotlib.pyplot as plt
import torch

from odak.learn.perception import slice_rgbd_targets
from odak.learn.tools import load_image
from odak.learn.wave import incoherent_focal_stack_rgbd

# %%
# A picture with its depth map, divided into five planes.
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

# %%
# One image for each focal plane, for three wavelengths.
stack = incoherent_focal_stack_rgbd(
    targets, masks, 8e-3 * positions, 8e-6, [639e-9, 515e-9, 473e-9]
)

# %%
# The focus moves from the near plane to the far one.
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
# Change: `8e-3 * positions` to `20e-3 * positions`: A deeper scene is blurred more where it is out of focus.
plt.show()
