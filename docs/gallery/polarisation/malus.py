"""Three polarisers

Crossed polarisers pass nothing. A third one between them, at an angle, lets light through again: sin²(2θ)/4 of it.
"""

import matplotlib.pyplot as plt
import numpy as np

from odak.jones import electricfield, linearpolarizer

angle = np.linspace(0, 180, 181)
light = electricfield(1, 0)
two = np.abs(linearpolarizer(light, angle)) ** 2
three = np.abs(linearpolarizer(linearpolarizer(light, angle), 90)) ** 2
two, three = two.sum((-2, -1)), three.sum((-2, -1))
deviation = np.abs(three - np.sin(np.radians(2 * angle)) ** 2 / 4).max()
print(f"largest deviation from the closed form: {deviation:.1e}")

# %%
figure, axis = plt.subplots(figsize=(8, 4))
axis.plot(angle, two, label="behind a polariser at θ: cos²θ")
axis.plot(angle, three, label="and one at 90° behind it: sin²(2θ)/4")
axis.set(xlabel="angle θ (°)", ylabel="transmission")
axis.legend()
# Picture: Transmission of two and of three polarisers by the angle of the middle one
plt.show()
