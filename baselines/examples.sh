### RopeShaping-v1 ###

# GRPD with BPP, 4 grippers, goal shape W
python baselines/train.py --env_id RopeShaping-v1 --policy grpd --algorithm bpp \
  --num_envs 64 --num_steps 100 --total_timesteps 1_000_000 --seed 1

# the same policy with PPO: only the loss differs
python baselines/train.py --env_id RopeShaping-v1 --policy grpd --algorithm ppo \
  --num_envs 64 --num_steps 100 --total_timesteps 1_000_000 --learning_rate 3e-4 --seed 1

# two grippers
python baselines/train.py --env_id RopeShaping-v1 --policy grpd --algorithm bpp \
  --env_kwargs num_grippers=2 --total_timesteps 2_000_000 --seed 1

# several goal shapes in one batch
python baselines/train.py --env_id RopeShaping-v1 --policy grpd --algorithm bpp \
  --env_kwargs 'shapes=["W","V","S"]' --total_timesteps 2_000_000 --seed 1

### Evaluation ###

python baselines/evaluate.py --checkpoint runs/NAME/final_ckpt.pt --num_episodes 200 --video runs/NAME/test.mp4

# a finer rope than the policy was trained on
python baselines/evaluate.py --checkpoint runs/NAME/final_ckpt.pt --env_kwargs resolution=81
