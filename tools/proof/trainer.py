"""A trainer that knows nothing of tagmill: a YOLO data.yaml in, what it finds in a set of pictures out.

Runs in an environment of its own (libreyolo and PyTorch; `make proof` makes it):
``python trainer.py DATA_YAML TRUTH_JSON FOUND_JSON --epochs N ...``. ``TRUTH_JSON`` is COCO's form, of which only the
pictures are looked at; ``FOUND_JSON`` becomes a list of COCO detections.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import torch
from libreyolo import LibreYOLOX

LEAST_SCORE = 0.01
_SAME_IOU = 0.65
_MOST = 20


def main() -> int:
    """Train, then look at the pictures."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("data", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("found", type=Path)
    parser.add_argument("--epochs", type=int, required=True)
    parser.add_argument("--width", type=int, required=True, help="of the picture that the network sees, px")
    parser.add_argument("--height", type=int, required=True)
    parser.add_argument("--batch", type=int, required=True)
    parser.add_argument("--rate", type=float, required=True)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    torch.set_num_threads(1)  # trainings run side by side; threads that wait for each other are slower on busy cores
    model = train(args)
    began = time.monotonic()
    images = json.loads(args.truth.read_text(encoding="utf-8"))["images"]
    found = [row for image in images for row in look(model, image, (args.height, args.width))]
    args.found.write_text(json.dumps(found), encoding="utf-8")
    print(f"looked at {len(images)} pictures in {time.monotonic() - began:.0f} s: {len(found)} detections")
    return 0


def train(args: argparse.Namespace) -> LibreYOLOX:
    """A YOLOX nano from random weights.

    No mosaic, mix-up or mirroring: with so few steps they cost more than they give, and a mirrored carton's lettering
    is no carton's. The last weights count, nothing is chosen by looking at a validation set.
    """
    names = json.loads(args.truth.read_text(encoding="utf-8"))["categories"]
    model = LibreYOLOX(None, size="n", nb_classes=len(names), device="cpu")
    began = time.monotonic()
    result = model.train(
        data=str(args.data),
        epochs=args.epochs,
        batch=args.batch,
        imgsz=(args.height, args.width),
        lr0=args.rate,
        optimizer="adamw",
        warmup_epochs=1,
        no_aug_epochs=max(args.epochs // 6, 1),
        mosaic_prob=0.0,
        mixup_prob=0.0,
        flip_prob=0.0,
        cache="ram",
        eval_interval=0,
        seed=args.seed,
        pretrained=False,
        device="cpu",
        workers=0,
        amp=False,
        project=str(args.found.parent / "runs"),
        name=args.found.stem,
        exist_ok=True,
    )
    print(f"trained in {time.monotonic() - began:.0f} s, last loss {result['final_loss']:.3f}")
    return LibreYOLOX(str(result["last_checkpoint"]), size="n", nb_classes=len(names), device="cpu")


def look(model: LibreYOLOX, image: dict[str, object], size: tuple[int, int]) -> list[dict[str, object]]:
    """What the detector finds in one picture, as COCO detections; ``size``: height and width of the network's."""
    result = model.predict(str(image["file_name"]), conf=LEAST_SCORE, iou=_SAME_IOU, imgsz=size, max_det=_MOST)
    boxes = result.boxes
    rows = zip(boxes.xyxy.tolist(), boxes.conf.tolist(), boxes.cls.tolist(), strict=True)
    return [
        {
            "image_id": image["id"],
            "category_id": int(kind),
            "bbox": [round(v, 2) for v in (x0, y0, x1 - x0, y1 - y0)],
            "score": round(score, 5),
        }
        for (x0, y0, x1, y1), score, kind in rows
    ]


if __name__ == "__main__":
    sys.exit(main())
