"""200 cloths into a table: one muscle on the front brings the lower edge less far forward than two to four do."""

import fabdesign


def main(grid: int = 21) -> None:
    counts = [1 + k % 4 for k in range(200)]
    cloths = [fabdesign.build("vertical", muscles=n, width=0.15 + 0.002 * (k // 4)) for k, n in enumerate(counts)]
    pressures = [[150] * n for n in counts]  # kPa
    result = fabdesign.sweep(cloths, pressures, {"forward": lambda m: m.faces[0, 0, -1, :, 2].mean()}, grid=grid)
    table = result.to_table()
    mean = table.groupby("muscles")["forward"].mean()
    print((1e3 * mean).round(1).to_string())  # mm
    assert len(table) == 200 and 0.01 < mean[1] < 0.9 * mean[2:].min()


if __name__ == "__main__":
    main()
