"""What the paper prints and the checks use, once. `tex:n` is line n of its LaTeX source."""

TABLES = {  # mean ± std of the "Final Return"
    "Acrobot": {  # section Acrobot, its table
        "DQN": (-154.82, 85.56),  # tex:729
        "GB-DQN": (-140.16, 88.52),  # tex:730
        "Ensemble": (-166.32, 97.39),  # tex:731
        "Reset": (-264.58, 130.77),  # tex:732
        "Sliding": (-149.59, 85.72),  # tex:733
    },
    "MountainCar": {  # section MountainCar, its table
        "DQN": (-176.33, 9.38),  # tex:780
        "GB-DQN": (-173.65, 17.54),  # tex:781
        "Ensemble": (-200.00, 19.20),  # tex:782
        "Reset": (-193.20, 7.46),  # tex:783
        "Sliding": (-182.21, 13.27),  # tex:784
    },
    "Hopper": {  # section Hopper, its table
        "DQN": (19.90, 40.01),  # tex:838
        "GB-DQN": (20.24, 32.64),  # tex:839
        "Ensemble": (18.14, 36.10),  # tex:840
        "Reset": (16.32, 32.59),  # tex:841
        "Sliding": (17.10, 38.67),  # tex:842
    },
}
RUNS = 5  # tex:742, 790, 853
LOWEST = {"Acrobot": -500.0, "MountainCar": -200.0}  # −1 a step, for at most so many: tex:706, 760
DRIFTS = (150, 250, 350, 450)  # episodes, on Acrobot and MountainCar: tex:707, 762
HIDDEN = {"acrobot": (128, 128), "hopper": (256, 256)}  # tex:709, 817
GAMMA = 0.99  # tex:706, 760, 814
SHRINKAGE = 0.1  # η_boost: tex:714, 763, 821
EPSILON = (1.0, 0.05)  # at the start and in the end: tex:713, 820
UPDATE_EVERY = 4  # steps: tex:712, 819
HOPPER_EPISODES = 500  # tex:814
HOPPER_DRIFTS = (100, 200, 300, 400)  # episodes: tex:815
HOPPER_WINDOW = 50_000  # transitions of the sliding window: tex:818
HOPPER_LEARNING_STARTS = 5_000  # steps: tex:819
HOPPER_EPSILON_STEPS = 100_000  # tex:820
