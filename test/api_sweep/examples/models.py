"""Valid arguments of odak.learn.models and odak.learn.lensless."""

from pathlib import Path

import torch
from api_sweep.build import Build, tensor

from odak.learn import models
from odak.log import logger

PICTURE = tensor(2, 2, 8, 8)
PAIR = [(tensor(4, 1), tensor(4, 1, seed=4))]
FACTORS = tensor(2, 18, 8, 8)
VOLUME = {"number_of_elements": 4}
FRAMES = tensor(2, 5, 180, 320)
LENGTHS = {"wavelength": 532e-9, "dx": 8e-6, "distance": 5e-3}


def written(name, write):
    """Return a sample: a file that `write` has put into an empty folder."""

    def build(folder):
        path = folder / name
        write(path)
        return path

    return Build(build)


def weights_of(make):
    """Return a sample: the weights of a module."""
    return written("a.pt", lambda path: torch.save(make().state_dict(), path))


def unwritten(name):
    """Return a sample: a file that does not exist yet."""
    return Build(lambda folder: folder / name)


def loss(model, batch):
    """Return the mean squared error of a batch."""
    return torch.nn.functional.mse_loss(model(batch[0]), batch[1])


def kernels():
    """Return factors for the small adaptive U-Net below."""
    maker = models.spatially_varying_kernel_generation_model(depth=1, dimensions=2, input_channels=3)
    return [kernel.detach() for kernel in maker(tensor(1, 1, 8, 8), tensor(1, 2, 8, 8))]


def no_callback(epoch, history):
    """Do nothing after an epoch."""


BY_NAME = {
    "odak.learn.models": {
        "L": 4,
        "activation": Build(lambda folder: torch.nn.LeakyReLU()),
        "batches": PAIR,
        "bias": True,
        "bottleneck_channels": 2,
        "depth": 1,
        "device": "cpu",
        "dim": 2,
        "dimensions": 2,
        "epochs": 2,
        "estimate": tensor(5),
        "extensions": [".pt"],
        "field": tensor(1, 2, 8, 8),
        "filename": unwritten("a.pt"),
        "focal_surface": tensor(1, 1, 8, 8),
        "gate_channels": 2,
        "ground_truth": tensor(5, seed=4),
        "initial_alphas": tensor(4, 1),
        "initial_angles": tensor(4, 3),
        "initial_centers": tensor(4, 3),
        "initial_scales": tensor(4, 3),
        "alphas": tensor(4, 1),
        "angles": tensor(4, 3),
        "centers": tensor(4, 3),
        "scales": tensor(4, 3),
        "input_channels": 2,
        "input_multiplier": 1.5,
        "kernel_size": 3,
        "learning_rate": 1e-3,
        "loss_weights": {"content": {"l2": 1.0}},
        "max_norm": 1.0,
        "mid_channels": 2,
        "module": Build(lambda folder: torch.nn.Linear(1, 1)),
        "multiplier": 1.5,
        "number_of_elements": 4,
        "number_of_epochs": 2,
        "out_channels": 2,
        "output_channels": 2,
        "points": tensor(5, 3),
        "progress": False,
        "reduction_ratio": 1,
        "residual": 1e-6,
        "stride": 1,
        "padding": 1,
        "scheduler_power": 1.0,
        "sv_kernel_feature": FACTORS,
        "verbose": False,
        "weights": {"content": {"l2": 1.0, "l1": 0.5}, "scale": {"larger": 1.0}},
        "weights_filename": unwritten("a.pt"),
        "x": PICTURE,
        "x0": PICTURE,
        "x1": PICTURE,
        "x2": tensor(2, 2, 8, 8, seed=4),
        "y": tensor(5, 1, seed=4),
    },
    "odak.learn.lensless": {
        "device": "cpu",
        "filename": unwritten("a.pt"),
        "x": FRAMES,
    },
}
BY_CALL = {
    "odak.learn.models.gaussian": {"x": tensor(5)},
    "odak.learn.models.swish": {"x": tensor(5)},
    "odak.learn.models.swish_activation.forward": {"x": tensor(5)},
    "odak.learn.models.gaussian_activation.forward": {"x": tensor(5, 2)},
    "odak.learn.models.film_siren_activation.forward": {"x": tensor(5, 2)},
    "odak.learn.models.positional_encoder.forward": {"x": tensor(5, 2)},
    "odak.learn.models.gaussian_2d.forward": {"x": tensor(5, 1)},
    "odak.learn.models.gaussian_2d.total": {"x": tensor(5, 1)},
    "odak.learn.models.gaussian_2d.initialize_parameters_uniformly": {"ranges": {"widths": (0.1, 0.5)}},
    "odak.learn.models.gaussians_2d": {"logger": logger},
    "odak.learn.models.gaussians_2d.forward": {"x": tensor(5, 1)},
    "odak.learn.models.gaussians_2d.load_weights": {"weights_filename": weights_of(lambda: models.gaussians_2d(4))},
    "odak.learn.models.gaussian_3d_volume.load_weights": {
        "weights_filename": weights_of(lambda: models.gaussian_3d_volume(4))
    },
    "odak.learn.models.hologram_network": {"channels": 2, "refinements": 1},
    "odak.learn.models.hologram_network.forward": {"target": tensor(8, 12), "depth": tensor(8, 12)} | LENGTHS,
    "odak.learn.models.hologram_network.stages": {"target": tensor(8, 12), "depth": tensor(8, 12)} | LENGTHS,
    "odak.learn.models.load_weights": {"filename": weights_of(lambda: torch.nn.Linear(1, 1))},
    "odak.learn.models.gaussian_2d.initialize_from_image": {
        "image": tensor(4, 5),
        "x": tensor(4, 5),
        "y": tensor(4, 5),
    },
    "odak.learn.models.gaussians_2d.initialize_from_image": {
        "image": tensor(4, 5),
        "x": tensor(4, 5),
        "y": tensor(4, 5),
    },
    "odak.learn.models.gaussian_2d.refine": {"image": tensor(4, 5), "x": tensor(4, 5), "y": tensor(4, 5), "steps": 2},
    "odak.learn.models.gaussians_2d.refine": {"image": tensor(4, 5), "x": tensor(4, 5), "y": tensor(4, 5), "steps": 2},
    "odak.learn.models.hash_grid_encoder": {
        "dimensions": 2,
        "levels": 2,
        "features": 2,
        "table_size": 64,
        "coarsest": 2,
        "finest": 4,
        "low": -1.0,
        "high": 1.0,
    },
    "odak.learn.models.hash_grid_encoder.forward": {"x": tensor(5, 2)},
    "odak.learn.models.multi_layer_perceptron": {"dimensions": [2, 3, 1]},
    "odak.learn.models.multi_layer_perceptron.forward": {"x": tensor(5, 2)},
    "odak.learn.models.non_local_layer": {"kernel_size": 1},
    "odak.learn.models.residual_attention_layer": {"kernel_size": 1},
    "odak.learn.models.upsample_convtranspose2d_layer": {"kernel_size": 2, "stride": 2},
    "odak.learn.models.upsample_convtranspose2d_layer.forward": {"x1": tensor(2, 2, 4, 4)},
    "odak.learn.models.upsample_layer.forward": {"x1": tensor(2, 2, 4, 4)},
    "odak.learn.models.spatially_adaptive_unet.forward": {"sv_kernel": Build(lambda folder: kernels())},
    "odak.learn.models.spatially_varying_kernel_generation_model": {"input_channels": 3},
    "odak.learn.models.train": {
        "model": Build(lambda folder: torch.nn.Linear(1, 1)),
        "loss": loss,
        "validation": PAIR,
        "optimizer": Build(lambda folder: torch.optim.SGD),
        "scheduler": Build(lambda folder: lambda made: torch.optim.lr_scheduler.ExponentialLR(made, 0.9)),
        "patience": 2,
        "seed": 3,
        "checkpoint": unwritten("run.pt"),
        "callback": no_callback,
    },
    "odak.learn.lensless.spec_track.load_weights": {
        "filename": Build(lambda folder: track_weights(folder)),
    },
}
_WRITTEN: list[Path] = []


def track_weights(folder):
    """Return a file with weights of odak.learn.lensless.spec_track, 65 MB that are written once."""
    from odak.learn.lensless import spec_track

    if not _WRITTEN:
        spec_track().save_weights(folder / "a.pt")
        _WRITTEN.append(folder / "a.pt")
    return _WRITTEN[0]


POSITIVE = {
    "odak.learn.models": {
        *(
            "L",
            "dim",
            "depth",
            "dimensions",
            "input_channels",
            "mid_channels",
            "output_channels",
            "bottleneck_channels",
        ),
        *("gate_channels", "reduction_ratio", "kernel_size", "stride", "number_of_elements", "checkpoint_every"),
    },
    "odak.learn.models.train": {"patience", "learning_rate", "max_norm"},
}
FREE_TEXT = {"odak.learn.models": {"description"}}
NOT_CALLED = {
    "odak.learn.lensless.spec_track.evaluate": "half a second to build the network for each argument; tested by itself",
    "odak.learn.lensless.spec_track.fit": "minutes for each argument; `odak.learn.models.train` checks all but two",
}
ALLOWED = {
    ("odak.learn.models.gaussian*", "[xy]", "infinity inside"): "a Gaussian is zero at infinity",
    ("odak.learn.models.hash_grid_encoder.forward", "x", "infinity inside"): "documented: held at the ends",
    ("odak.learn.models.gaussian_3d_volume.forward", "points", "infinity inside"): "a Gaussian is zero at infinity",
    ("odak.learn.models.gaussian_2d.forward", "residual", "*"): "documented: without effect",
    ("odak.learn.models.gaussian_3d_volume.optimize", "*", "* inside"): "documented: FloatingPointError",
    ("odak.learn.models.normalization.forward", "x", "in half precision"): "the floor of the variance is higher there",
}
