"""What each ablation of GRPD takes away, and that it takes away nothing else."""

import pytest
import torch
from random_graphs import SCHEMA, make_graph, move, relative_error, rotation_from_quaternion
from test_equivariance import symmetry_errors, trained_looking_policy

from maniskill_grpd.policies import make_policy

GRPD = make_policy("grpd", SCHEMA)


def size(**options):
    return sum(parameter.numel() for parameter in make_policy("grpd", SCHEMA, **options).parameters())


@pytest.mark.parametrize("options", [{"coordinates": "raw"}, {"weights": "shared"}])
def test_an_ablation_has_as_many_parameters(options):
    assert size(**options) == pytest.approx(size(), rel=0.06)


def test_raw_coordinates_change_the_first_layers_alone():
    raw = make_policy("grpd", SCHEMA, coordinates="raw").state_dict()
    changed = {name for name, weight in GRPD.state_dict().items() if raw[name].shape != weight.shape}
    assert raw.keys() == GRPD.state_dict().keys()
    assert {name.split(".")[1] for name in changed} == {"embed_object", "embed_actuator"}


@pytest.mark.parametrize("motion", ["turned", "shifted"])
def test_raw_coordinates_have_no_symmetry(motion):
    """Of every output and 20 scenes the smallest error counts; the same motions leave GRPD's at rounding."""
    rotation, translation = torch.eye(3, dtype=torch.float64), torch.tensor([0.3, 0.0, 0.0], dtype=torch.float64)
    if motion == "turned":
        rotation, translation = rotation_from_quaternion((1.0, 0.0, 0.0, 1.0)), torch.zeros(3, dtype=torch.float64)
    for seed in range(20):
        graph = make_graph(seed=seed, dtype=torch.float64)
        raw, relative = (trained_looking_policy(torch.float64, seed, coordinates=kind) for kind in ("raw", "relative"))
        assert min(symmetry_errors(raw, graph, rotation, translation).values()) > 1e-3
        assert max(symmetry_errors(relative, graph, rotation, translation).values()) < 1e-10


@torch.no_grad()
def test_without_their_messages_actuators_are_blind_to_objects_and_the_value_is_not():
    graph, other = make_graph(seed=1), make_graph(seed=1)
    other["object"] = make_graph(seed=2)["object"]
    for is_heard in (True, False):
        policy = trained_looking_policy(torch.float32, 0, object_messages=is_heard)
        (first, value), (second, other_value) = policy(graph), policy(other)
        assert torch.equal(first.mean, second.mean) != is_heard
        assert not torch.allclose(value, other_value)


def test_shared_weights_are_one_embedding_and_one_round():
    encoder = make_policy("grpd", SCHEMA, weights="shared").encoder
    assert {name.split(".")[0] for name, _ in encoder.named_parameters()} == {"embed", "rounds"}
    assert len(encoder.rounds) == 1
    assert not hasattr(GRPD.encoder, "rounds")


@torch.no_grad()
@pytest.mark.parametrize("weights", ["shared", "typed"])
def test_messages_flow_along_the_same_edges(weights):
    """An object node hears its neighbours of the mesh; actuators hear each other and every object node, whatever the weights."""
    policy = trained_looking_policy(torch.float64, 0, weights=weights)
    graph = make_graph(1, nodes=6, actuators=2, dtype=torch.float64)
    graph["object"]["neighbors"] = torch.tensor([[[1], [0], [-1], [-1], [-1], [-1]]])
    before_objects, before_tools = policy.encoder(policy.prepare(graph))
    for node, hears in ((0, [0, 1]), (5, [5])):
        changed = make_graph(1, nodes=6, actuators=2, dtype=torch.float64)
        changed["object"]["neighbors"] = graph["object"]["neighbors"]
        changed["object"]["scalars"][0, node] += 1.0
        objects, tools = policy.encoder(policy.prepare(changed))
        moved = (objects[0] - before_objects[0]).abs().amax(-1)[0] > 1e-12
        assert moved.nonzero().flatten().tolist() == hears
        assert ((tools[0] - before_tools[0]).abs().amax(-1)[0] > 1e-12).all()


def test_two_ablations_at_once_are_refused():
    with pytest.raises(ValueError, match="two ablations"):
        make_policy("grpd", SCHEMA, coordinates="raw", weights="shared")


@torch.no_grad()
def test_a_motion_that_changes_nothing_changes_no_raw_output():
    """The control of the motions above: the error of none is zero."""
    policy = trained_looking_policy(torch.float64, 0, coordinates="raw")
    graph = make_graph(dtype=torch.float64)
    still = move(graph, torch.eye(3, dtype=torch.float64), torch.zeros(3, dtype=torch.float64))
    assert relative_error(policy(still)[0].mean, policy(graph)[0].mean) == 0.0
