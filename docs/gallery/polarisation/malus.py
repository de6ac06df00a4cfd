"""Three polarisers

Two crossed polarisers pass nothing. A third one between them lets light through again, which surprises everybody once.
Each polariser projects the field on its axis, by Malus cos²θ of the power; two projections by θ and 90° − θ leave
sin²(2θ)/4.

[Polarisation](../../guides/polarisation.md) goes on from here.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.jones import electricfield, linearpolarizer

# %%
# An array of angles is one call: fields have the shape `[2, …]`.
angle = np.linspace(0, 180, 181)
light = electricfield(1, 0)
two = np.abs(linearpolarizer(light, angle)) ** 2
three = np.abs(linearpolarizer(linearpolarizer(light, angle), 90)) ** 2
two, three = two.sum((-2, -1)), three.sum((-2, -1))
deviation = np.abs(three - np.sin(np.radians(2 * angle)) ** 2 / 4).max()
print(f"largest deviation from the closed form: {deviation:.1e}")

# %%
# At 45° a quarter of the light passes.
figure, axis = plt.subplots(figsize=(8, 4))
axis.plot(angle, two, label="behind a polariser at θ: cos²θ")
axis.plot(angle, three, label="and one at 90° behind it: sin²(2θ)/4")
axis.set(xlabel="angle θ (°)", ylabel="transmission")
axis.legend()
# Picture: Transmission of two and of three polarisers by the angle of the middle one
# Change: `linearpolarizer(light, angle), 90)` to `linearpolarizer(light, angle), 60)`: With the last polariser at 60° the curve is no longer symmetrical, its maximum lies at 30°, and it is zero at 90° and 150°: the closed form, for 90°, no longer describes it.
plt.show()
