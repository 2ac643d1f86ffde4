"""What can be read of a drawn figure: labels that are whole and apart, colours that stand out."""

from itertools import combinations


def shared_label(axes, direction):
    """Return the label of one direction of an axes, its own or that of the axes it shares it with."""
    shared = axes.get_shared_x_axes() if direction == "x" else axes.get_shared_y_axes()
    labels = [getattr(one, f"get_{direction}label")() for one in (axes, *shared.get_siblings(axes))]
    return next((label for label in labels if label), "")


def axis_texts(axis):
    """Return the label of an axis and those of its ticks, as far as they are drawn."""
    low, high = sorted(axis.get_view_interval())
    return [axis.label, *(tick.label1 for tick in axis.get_major_ticks() if low <= tick.get_loc() <= high)]


def assert_whole_and_apart(figure, texts):
    """Assert that some texts of a figure that was drawn lie within it, and none over another."""
    # A pixel of the screen, by which the layout may be off.
    whole = figure.bbox.padded(1.0)
    shown = [text for text in texts if text.get_visible() and text.get_text()]
    boxes = [(text.get_text(), text.get_window_extent()) for text in shown]
    for text, box in boxes:
        assert whole.x0 <= box.x0 <= box.x1 <= whole.x1, text
        assert whole.y0 <= box.y0 <= box.y1 <= whole.y1, text
    for (one, box), (other, beside) in combinations(boxes, 2):
        assert not box.overlaps(beside), (one, other)


def contrast(one, other):
    """Return the contrast of two colours (WCAG 2.2), each of red, green and blue from 0 to 255."""
    low, high = sorted(map(_luminance, (one, other)))
    return (high + 0.05) / (low + 0.05)


def _luminance(colour):
    parts = [part / 255 for part in colour]
    red, green, blue = (c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in parts)
    return 0.2126 * red + 0.7152 * green + 0.0722 * blue
