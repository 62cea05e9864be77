import pytest
import torch

from dirl.training.objectives import TFRMSprop, clip_each


def by_formula(weight, gradient_steps, lr, alpha=0.99, eps=0.1):
    """TensorFlow's update, written out."""
    square = 1.0
    for gradient in gradient_steps:
        square = alpha * square + (1 - alpha) * gradient**2
        weight = weight - lr * gradient / (square + eps) ** 0.5
    return weight


@pytest.mark.parametrize("steps", [1, 2, 30])
def test_rmsprop_is_tensorflows(steps):
    torch.manual_seed(0)
    weights, gradient_steps = torch.randn(3, dtype=torch.float64), torch.randn(steps, 3, dtype=torch.float64) * 5
    parameter = torch.nn.Parameter(weights.clone())
    optimiser = TFRMSprop([parameter], lr=0.1)
    for gradient in gradient_steps:
        parameter.grad = gradient.clone()
        optimiser.step()
    torch.testing.assert_close(parameter.data, by_formula(weights, gradient_steps, 0.1))


def test_rmsprop_takes_each_groups_own_options_and_a_changed_rate():
    parameters = [torch.nn.Parameter(torch.ones(1, dtype=torch.float64)) for _ in range(2)]
    optimiser = TFRMSprop([{"params": parameters[:1]}, {"params": parameters[1:], "alpha": 0.5, "eps": 2.0}], lr=1.0)
    optimiser.param_groups[0]["lr"] = 0.25
    for parameter in parameters:
        parameter.grad = torch.full((1,), 3.0, dtype=torch.float64)
    optimiser.step()
    assert parameters[0].item() == pytest.approx(by_formula(1, [3], 0.25))
    assert parameters[1].item() == pytest.approx(by_formula(1, [3], 1.0, 0.5, 2.0))


def test_rmsprop_leaves_what_has_no_gradient_and_starts_its_mean_square_late():
    first, late = (torch.nn.Parameter(torch.ones(1, dtype=torch.float64)) for _ in range(2))
    optimiser = TFRMSprop([{"params": [first]}, {"params": [late]}], lr=0.1)
    first.grad = torch.ones(1, dtype=torch.float64)
    optimiser.step()
    assert late.item() == 1
    first.grad, late.grad = None, torch.full((1,), 2.0, dtype=torch.float64)
    optimiser.step()
    assert first.item() == pytest.approx(by_formula(1, [1], 0.1))
    assert late.item() == pytest.approx(by_formula(1, [2], 0.1))


def test_rmsprop_goes_on_from_a_state_dict():
    parameter = torch.nn.Parameter(torch.ones(2, dtype=torch.float64))
    optimiser = TFRMSprop([parameter], lr=0.1)
    for gradient in (1.0, -4.0):
        parameter.grad = torch.full((2,), gradient, dtype=torch.float64)
        optimiser.step()
        state = optimiser.state_dict()
        optimiser = TFRMSprop([parameter])
        optimiser.load_state_dict(state)
    assert parameter.tolist() == pytest.approx([by_formula(1, [1, -4], 0.1)] * 2)


def test_rmsprop_evaluates_a_closure_with_gradients():
    parameter = torch.nn.Parameter(torch.ones(1, dtype=torch.float64))
    optimiser = TFRMSprop([parameter], lr=0.1)

    def closure():
        loss = parameter.square().sum()
        loss.backward()
        return loss.item()

    assert optimiser.step(closure) == 1
    assert parameter.item() == pytest.approx(by_formula(1, [2], 0.1))


def test_each_variable_is_clipped_by_its_own_norm():
    parameters = [torch.nn.Parameter(torch.zeros(2)) for _ in range(4)]
    for parameter, gradient in zip(parameters, ([30.0, 40.0], [3.0, 4.0], [0.0, 0.0]), strict=False):
        parameter.grad = torch.tensor(gradient)
    clip_each(parameters, 10)
    assert parameters[0].grad.tolist() == pytest.approx([6, 8])
    assert parameters[1].grad.tolist() == [3, 4]
    assert parameters[2].grad.tolist() == [0, 0]
    assert parameters[3].grad is None
