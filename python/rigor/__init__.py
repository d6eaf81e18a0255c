"""Rigor: rigs of real and simulated sensors, from Python.

    import rigor

    rec = rigor.open("demo.mcap"); rec["left"].array(); rec["left"].stamps       recordings, any MCAP file of ROS 2
    picture, truth = rigor.sense("demo", "right", at=2.0, seed=7)                 one sample, with ground truth
    with rigor.Rig("demo", clock="virtual") as rig:                               a rig, step by step or in one
        while rig.step(10): ...
    fit = rigor.calibrate.camera("pictures/", target="chessboard:9x6:0.025")      models from recordings
    for sample in rigor.dataset("demo", within=(-3, -4, 3, -2), samples=100): ...  labelled pictures, clouds, range images
    trees = rigor.World("forest.import.yaml").query(type="Tree", within=(0, 0, 20))
    rigor.models                                                                  error models, with derivatives
    rigor.Env                                                                     a rig to learn with

Arrays are NumPy's; units stand in the names; docs/python.md is the guide.
"""
from . import calibrate, models
from ._application import Application
from ._dataset import Dataset, DatasetSample, View, dataset
from ._env import Env
from ._errors import (BadInput, DiskFull, Error, IoError, NotFound, NotWritable, ProtocolError, Timeout, Unavailable,
                      WrongState)
from ._recording import Channel, Pair, Recording, Topic, open
from ._rig import Port, Report, Rig, rigs
from ._rigor import version as __version__
from ._samples import POINT, Sample
from ._sense import Sensor, Truth, sense
from ._world import Node, Nodes, World

__all__ = ["Application", "BadInput", "Channel", "Dataset", "DatasetSample", "DiskFull", "Env", "Error", "IoError", "Node", "Nodes", "NotFound",
           "NotWritable", "POINT", "Pair", "Port", "ProtocolError", "Recording", "Report", "Rig", "Sample", "Sensor", "Timeout",
           "Topic", "Truth", "Unavailable", "View", "World", "WrongState", "calibrate", "dataset", "models", "open", "rigs", "sense"]
