"""Small networks, and batches that they read."""

import functools

import torch
import torch.nn.functional as F
from tensordict import TensorDict
from torchrl.modules import GRUModule

from dirl.models import ActorCritic, ActorCriticHeads, FeatureTable, SiameseEncoder, feature_statistics
from dirl.perception.backbones import ResNet50, registry
from dirl.perception.backbones.efficientnet import EfficientNetLite0

STATES, FEATURES, WIDTH, SCENES = 30, 7, 12, ("bath", "bed", "kitchen")
# What is seen from each state: first the state itself.
SURROUNDING = torch.randint(STATES, (STATES, 4), generator=torch.Generator().manual_seed(9))
SURROUNDING[:, 0] = torch.arange(STATES)


def make_policy(
    features, scenes, *, statistics=(), width=WIDTH, seed=0, shared=False, memory=False, encoder=SiameseEncoder
):
    """An `ActorCritic` on the features of some states, whose weights the seed decides."""
    table = FeatureTable(features, *statistics)
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        made = encoder(table.width, width)
        gru = GRUModule(input_size=width, hidden_size=width, in_key="fused", out_key="memory") if memory else None
        return ActorCritic(table, made, ActorCriticHeads(scenes, width, 4, width, shared), gru)


def standardised_policy(**options):
    """The policy of most tests: three scenes, 30 states with 7 features each, standardised."""
    features = torch.randn(STATES, FEATURES, generator=torch.Generator().manual_seed(0)) * 3 + 1
    return make_policy(features, SCENES, statistics=feature_statistics(features), seed=1, **options)


def batch_of(view_ids, goal_view_ids, scene):
    """What a policy without memory reads."""
    return TensorDict({"view_ids": view_ids, "goal_view_ids": goal_view_ids, "scene": scene}, [len(scene)])


def seen(seed=0, rows=80):
    """View ids, goal view ids and scenes of agents, many of whom see the same, some of them another's goal."""
    generator = torch.Generator().manual_seed(seed)
    kinds = SURROUNDING[torch.randperm(STATES, generator=generator)[:12]]
    views, goal_views = (kinds[first + torch.randint(8, (rows,), generator=generator)] for first in (0, 4))
    return views, goal_views, torch.randint(len(SCENES), (rows,), generator=generator)


def plain(policy, view_ids, goal_view_ids):
    """The fused vectors as the encoder computes them on features, every row by itself."""
    return policy.encoder(policy.features(view_ids), policy.features(goal_view_ids))


def gradients(module, output):
    """The gradients of a module's parameters, of a sum of the output in which every entry has another weight."""
    module.zero_grad()
    weights = torch.linspace(-1, 1, output.numel()).view_as(output)
    (output * weights).sum().backward()
    return [parameter.grad for parameter in module.parameters()]


def coarse_networks(patch):
    """Encode views of 32 x 32 pixels, in a twentieth of the time, where nobody looks at the features."""
    for network, stage in ((EfficientNetLite0, "inner_stage"), (ResNet50, "third_stage")):
        patch.setattr(network, stage, _coarse(getattr(network, stage)))
        patch.setattr(network, "pool", lambda self, seen, pool=network.pool: pool(self, seen[..., ::4, ::4]))
    for name in ("_resnet", "lite0_encoder"):  # encoders that are kept pool as they did when they were made
        load = getattr(registry, name)
        patch.setattr(registry, name, functools.cache(getattr(load, "__wrapped__", load)))


def _coarse(stage):
    def seen(self, images):
        height, width = images.shape[2:]
        return F.interpolate(stage(self, F.interpolate(images, (32, 32))), (-(-height // 16), -(-width // 16)))

    return seen
