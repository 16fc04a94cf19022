"""Train BP2: `python train.py --stage imitation`, then `python train.py --stage relaxed`."""

from bp2_rl.cli.train import main

if __name__ == "__main__":
    raise SystemExit(main())
