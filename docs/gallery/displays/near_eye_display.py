"""From the pixels to the retina

Pixels, a lens, a coated mirror and an eye that looks at a spoon, in one graph: descent
finds the pattern and the curvatures of the lens, which begins too weak for the picture.
"""
from importlib.resources import files
import matplotlib.pyplot as plt
import torch
from odak.learn import perception, wave
from odak.learn.raytracing import system as optics
from odak.learn.raytracing.system import surface
shape, pitch, green, focal = (160, 240), 8e-6, 532e-9, 15e-3
photo = wave.light_of(files("odak") / "assets" / "photo.png", green).targets
photo = torch.nn.functional.adaptive_avg_pool2d(photo, shape)[0]
panel = wave.Display(wave.Modulator(shape, pitch), green, distances=5e-3)
lens = surface(16.5, thickness=3.0, material="N-BK7"), surface(-16.5, thickness=5.0)
mirror = surface(material="mirror", coating=optics.Coating([2.3], [60e-6], 1.5))
fold = [optics.coordinate_break(tilt=(45, 0, 0), thickness=t) for t in (0, -9, -6)]
near = {"wavelengths": 1e3 * green, "object_distance": 13.9}
eyepiece = optics.optical_system([*lens, fold[0], mirror, fold[1]], 1.2, **near)
samples = green * focal / (288 * pitch), (576, 576)
element = optics.TracedSystem(eyepiece, *samples, polarization=(1, 0))
gaze = torch.tensor([0.8, 1.1])  # degrees to the right and down
place = 0.5 + gaze.deg2rad() * focal / pitch / torch.tensor(shape[::-1])
view = {"real_image_width": shape[1] * pitch, "real_viewing_distance": focal}
angle = perception.make_eccentricity_distance_maps(place, shape, **view)[0].rad2deg()
weight, mean = perception.highest_frequency(angle) ** 2, torch.nn.functional.avg_pool2d

def seen(phases):
    pupil, step = element.apply(panel.fields(phases)[0, 0, 0], pitch, green)
    retina = optics.retinal_field(pupil, step, green, rotation=gaze, center="field")
    light = retina.field.abs()[None, 127:448, 47:528] ** 2  # two samples for each pixel
    light = mean(mean(light, 2, 1), 2)[0]  # over the area of a pixel
    return light * (light * photo).sum() / (light**2).sum()
phases = wave.optimise(panel, photo, run=wave.Run(iterations=30, progress=False)).phases
before = seen(phases)
optimizer = torch.optim.Adam([phases.requires_grad_()], lr=0.1, betas=(0.7, 0.9))
optimizer.add_param_group({"params": eyepiece.vary(curvature=[0, 1]), "lr": 1e-3})
for _ in range(40):
    optimizer.zero_grad()
    (weight * (seen(phases) - photo) ** 2).mean().backward()
    optimizer.step()
after = seen(panel.modulator.shown(phases.detach())).detach()
for picture in (before, after):
    error = (picture - photo) ** 2
    here, over = (-10 * part.mean().log10() for part in (error[angle < 1], error))
    print(f"≈ {here:.0f} dB at the gaze (1°), ≈ {over:.0f} dB over the picture")
eye = [surface(-s.radius, thickness=-s.thickness, material=s.material, semi_diameter=4)
       for s in optics.navarro_eye().surfaces]
near |= {"image": surface(12.0, semi_diameter=10), "fields": [-0.6, 0, 0.6]}
whole = optics.optical_system([*lens, fold[0], mirror, fold[2], *eye], 2.0, **near)
figure, axes = plt.subplot_mosaic("LTB;LPA", figsize=(14, 6), layout="constrained")
stored = [wave.picture_of(light[None], green)[0] for light in (photo, before, after)]
pictures = {"": optics.draw_layout(whole)}
pictures |= dict(zip(("the picture", "seen before", "seen after"), stored))
pictures |= {"the panel": phases.detach()[0] % 6.28 / 6.28}
for key, (title, picture) in zip("LTBAP", pictures.items()):
    axes[key].imshow(picture, cmap="gray", vmin=0, vmax=1)
    axes[key].set(title=title, xticks=[], yticks=[], frame_on=False)
# Thumbnail: 0.702 0.545 0.992 0.985
# Picture: A lens, a mirror and an eye with rays; the pattern, and what the eye sees of it
plt.show()
