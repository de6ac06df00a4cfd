"""Frames, speckle, resolution and depth of focus

A hologram whose image has a random phase fills the stop with light: it blurs away from its plane as a real object does,
and has finer detail of less contrast, but also speckle, which only frames remove. A smooth phase has no speckle, and
stays sharp over a large depth. In between lies a phase that fills a share of the stop.

[Panels of few levels](../../guides/displays.md#panels-of-few-levels) show many frames.
"""

import matplotlib.pyplot as plt
import torch
from scipy.special import j1

from odak.learn.wave import propagate_beam

# %%
# Frames of a faint grating, lit from all directions in a share of a round stop at random, behind that stop.
pitch, size, wavelength, frames, stop = 8e-6, 192, 532e-9, 64, 15e3
axis = torch.fft.fftfreq(size, pitch)
frequency = torch.hypot(axis[:, None], axis)
columns = torch.arange(size) * pitch
generator = torch.Generator().manual_seed(0)


def images(cycles, share, distances=(0.0,)):
    """Return intensities [distances, frames, rows, columns] of a grating."""
    tone = cycles / (size * pitch)
    grating = 1 + 0.15 * torch.cos(2 * torch.pi * tone * columns)
    light = torch.randn(frames, size, size, dtype=torch.complex64, generator=generator)
    light = torch.fft.ifft2(light * (frequency <= share * stop))
    field = torch.fft.ifft2(torch.fft.fft2(grating * light) * (frequency <= stop))
    field = field / field.abs().square().mean().sqrt()
    way = pitch, wavelength, "Angular Spectrum"
    periodic = {"zero_padding": (False, False, False)}
    shown = [propagate_beam(field, None, z, *way, **periodic) for z in distances]
    return torch.stack(shown).abs().square()


def modulation(shown, cycles):
    """Return the contrast of the grating in the mean of all frames."""
    rows = shown.mean((1, 2))
    spectrum = torch.fft.rfft(rows).abs()
    return 2 * spectrum[:, cycles] / spectrum[:, 0] / 0.3


# %%
# Contrast of speckle over frames, of the grating over defocus, and over its frequency. Lines over defocus are the
# transform of the disc of directions, 2·J1(x)/x, times what coherent light loses; of a full stop, whose rim keeps part
# of the diffracted light away, they would not be right.
shares, counts = (0.25, 0.5, 1.0), (1, 2, 4, 8, 16, 32, 64)
defocus = torch.linspace(0, 15e-3, 16)
tones = (3, 8, 13, 18, 23, 28, 33, 38, 43)
figure, (speckle, depth, detail) = plt.subplots(
    1, 3, figsize=(13, 3.6), layout="constrained"
)
for share in shares:
    flat = images(0, share)[0]
    contrast = [float((m := flat[:n].mean(0)).std() / m.mean()) for n in counts]
    speckle.loglog(counts, contrast, "o", label=f"{share:g} of the stop")
    blurred = modulation(images(8, share, defocus.tolist()), 8)
    drawn = depth.plot(1e3 * defocus, blurred / blurred[0], "o")
    turn = 2 * torch.pi * wavelength * share * stop * 8 / (size * pitch) * defocus
    turn = turn.clamp_min(1e-6)
    disc = torch.from_numpy(2 * j1(turn.numpy())) / turn
    talbot = torch.cos(torch.pi * wavelength * (8 / (size * pitch)) ** 2 * defocus)
    if share < 1:
        depth.plot(1e3 * defocus, disc * talbot, color=drawn[0].get_color())
    found = [float(modulation(images(n, share), n)[0]) for n in tones]
    detail.plot([1e-3 * n / (size * pitch) for n in tones], found, "o-")
speckle.loglog(counts, [n**-0.5 for n in counts], "k", label="1/√frames")
speckle.set(xlabel="frames", ylabel="contrast of speckle")
speckle.legend()
depth.set(xlabel="defocus (mm)", ylabel="contrast of 5 lines/mm")
detail.set(xlabel="lines/mm in focus", ylabel="contrast")
detail.axvline(1e-3 * stop, color="0.6", linestyle=":")
# Thumbnail: 0.3
# Picture: Contrast of speckle over frames, of a grating over defocus, and of gratings over their frequency
plt.show()
