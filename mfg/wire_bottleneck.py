from mfg.outcome import *


def bottleneck(blueprint, graph, seat, name, taken):
    return Failure(Stage.WIRE, Reason.NO_ROUTE, f"{name} no way")
