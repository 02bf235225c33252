"""Makes the documents' pictures of what `pose-eval demo --pictures FROM` drew:
`python scripts/pictures.py FROM TO`.
"""

import io
import sys
from pathlib import Path

import matplotlib
import resvg_py
from PIL import Image

WIDTH_PX, COLOURS = 1600, 256
FONTS = Path(matplotlib.get_data_path()) / "fonts" / "ttf"  # the same on every machine


def main() -> None:
    """Draws the screen with a font that is everywhere, and makes both files small."""
    drawn, documents = map(Path, sys.argv[1:])
    screen = (drawn / "screen.svg").read_text().replace("Fira Code", "DejaVu Sans Mono")
    png = resvg_py.svg_to_bytes(
        svg_string=screen, font_dirs=[str(FONTS)], skip_system_fonts=True, width=WIDTH_PX
    )
    pictures = {"screen": Image.open(io.BytesIO(bytes(png))), "map": Image.open(drawn / "map.png")}
    for name, picture in pictures.items():
        small = picture.resize((WIDTH_PX, round(picture.height * WIDTH_PX / picture.width)))
        file = documents / f"{name}.png"
        small = small.convert("RGB")
        if name == "map":  # a dozen colours and their shades
            small = small.quantize(COLOURS)
        small.save(file, optimize=True)
        print(f"{file}: {file.stat().st_size // 1000} kB")


if __name__ == "__main__":
    main()
