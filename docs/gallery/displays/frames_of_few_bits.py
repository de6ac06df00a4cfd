"""Frames of few bits: speckle, depth and detail

Patterns of a panel that are found together, from random phases on, make up for each other's speckle, but only in
focus. Beside it their speckles are as independent as those of other random phases: contrast falls as 1/√frames, with
one bit as with eight. In exchange details blur away from the plane. Those of a smooth phase do not: they are distorted
there, and their contrast may rise.

[Panels of few levels](../../guides/displays.md#panels-of-few-levels) are solved for; the trade for light of any stop is
in [Frames, speckle, resolution and depth of focus](frames_and_depth.md).
"""

import matplotlib.pyplot as plt
import torch

from odak.learn.wave import Display, Modulator, Run, optimise

# %%
# Faint lines of seven frequencies along the columns: what differs from row to row is speckle.
shape, pitch, wavelength, plane = (48, 96), 8e-6, 532e-9, 3e-3
tones = torch.tensor([2, 5, 8, 13, 19, 26, 34])
places = torch.arange(shape[1]) / shape[1]
lines = torch.ones(shape[1])
for k, tone in enumerate(tones):
    lines += 0.13 * torch.cos(2 * torch.pi * (tone * places + k**2 / 14))
target = (lines / lines.max()).expand(shape).contiguous()
run = Run(iterations=30, progress=False, seed=0)


def judged(bits, frames, start, defocus):
    """Return contrasts of speckle, and of the lines, on planes beside the focus."""
    panel = Modulator(shape, pitch, bits)
    display = Display(panel, wavelength, plane, frames=frames)
    found = optimise(display, target, start=start, run=run)
    planes = [plane + z for z in defocus]
    there = Display(panel, wavelength, planes, frames=frames)
    images = there.judge(found.phases).areas[:, 0, 12:-12]
    mean = images.mean(1)
    speckle = (images - mean[:, None]).square().mean((1, 2)) / mean.square().mean(1)
    kept = torch.fft.rfft(mean).abs()[:, tones] / mean.sum(1, keepdim=True)
    asked = torch.fft.rfft(lines).abs()[tones] / lines.sum()
    return speckle.sqrt(), kept / asked


# %%
# The contrast of one frame is that of independent speckle, whose light fills the order as that of a pixel does, on
# pixels of a camera: along each axis a mean over the area of the correlation's square.
across, aside = torch.linspace(-0.5, 0.5, 401), torch.linspace(-1, 1, 401)
share = torch.sinc(0.9**0.5 * across).square()
waves = torch.cos(2 * torch.pi * aside[:, None] * across)
correlation = (waves * share).sum(1) / share.sum()
single = float(torch.trapezoid((1 - aside.abs()) * correlation**2, aside))

# %%
counts, defocus = (1, 2, 4, 8, 16), (0, 1e-3, 0.25e-3, 0.5e-3, 0.75e-3, 1.5e-3, 2e-3)
order = sorted(range(len(defocus)), key=defocus.__getitem__)
figure, (speckle, depth, detail) = plt.subplots(
    1, 3, figsize=(13, 3.6), layout="constrained"
)


def draw_lines(kept, label, color):
    beside = [1e3 * defocus[i] for i in order]
    depth.plot(beside, kept[order, 2], "o-", color=color, label=label)
    detail.plot(1e-3 * tones / (shape[1] * pitch), kept[0], "o-", color=color)


kept = judged(8, 1, "quadratic", defocus)[1]
draw_lines(kept, "smooth, 8 bits, 1 frame", "0.5")
for bits, color in ((8, "C0"), (1, "C1")):
    contrast = []
    for frames in counts:
        planes = defocus if frames == counts[-1] else defocus[:2]
        found, kept = judged(bits, frames, "random", planes)
        contrast.append(found[:2])
        if bits == 1:
            print(f"frames {frames}: {found[0]:.2f} in focus, {found[1]:.2f} beside")
    focus, beside = torch.stack(contrast).T
    word = "bit" if bits == 1 else "bits"
    speckle.loglog(counts, focus, "o-", color=color, label=f"{bits} {word}, in focus")
    speckle.loglog(counts, beside, "s", color=color, label=f"{bits} {word}, 1 mm away")
    draw_lines(kept, f"random, {bits} {word}, {counts[-1]} frames", color)
law = [single * n**-0.5 for n in counts]
speckle.loglog(counts, law, "k", lw=1, label=f"{single:.2f}/√frames")
speckle.set(xlabel="frames", ylabel="contrast of speckle")
speckle.set_xticks(counts, counts)
speckle.minorticks_off()
speckle.legend(fontsize=8)
depth.set(xlabel="defocus (mm)", ylabel="contrast kept of 10 lines/mm", ylim=(0, 1.3))
depth.legend(fontsize=8)
detail.set(xlabel="lines/mm in focus", ylabel="contrast kept", ylim=(0, 1.3))
# Thumbnail: 0.3
# Picture: Contrast of speckle over frames of eight bits and one, in focus and beside it, of lines over defocus, and of lines over their frequency
plt.show()
