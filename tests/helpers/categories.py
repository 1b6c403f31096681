"""The shipped categories, and one that is not."""

from omad.objects.builtin import builtin_names
from omad.objects.category import Category, JointSpec, PartSpec
from omad.objects.category_file import get_category

LAPTOP, EYEGLASSES, DISHWASHER, SCISSORS, DRAWER = ALL = tuple(
    get_category(name) for name in ("laptop", "eyeglasses", "dishwasher", "scissors", "drawer")
)
CATEGORIES = {category.name: category for category in ALL}
"""The paper's, in its order."""
EVERY = {name: get_category(name) for name in builtin_names()}

CHEST = Category(
    name="chest",
    metres_per_unit=0.45,
    parts=(PartSpec("frame", 2), *(PartSpec(f"drawer {i}", 2, aliases=("drawer",)) for i in range(3))),
    joints=tuple(
        JointSpec(f"slide {i}", "prismatic", 0, (0.0, 0.0, 1.0), (0.0, 1.0), side=(0.0, 1.0 - i, 0.5)) for i in range(3)
    ),
    source_names=("StorageFurniture",),
)
"""Its drawers are alike but for their places."""
