"""The words of the live view, in English and Chinese."""

from __future__ import annotations

LANGUAGES = ("en", "zh")

# Key: English, Chinese. What the daemon says of its parts and events is English and stays so.
_TEXTS = {
    "live": ("LIVE", "实时"),
    "silent": ("SILENT", "无数据"),
    "gone": ("NO DAEMON", "守护进程不在"),
    "waiting": ("CONNECTING", "正在连接"),
    "paused": ("PAUSED", "已暂停"),
    "paused_since": ("paused at {0}: nothing below is new", "{0} 暂停：以下数据不再更新"),
    "silent_for": ("connected, but silent for {0} s", "已连接，但 {0} 秒没有数据"),
    "old": ("old numbers, last heard {0}", "旧数据，最后收到 {0}"),
    "lost": ("this terminal is too slow: {0} lines lost", "终端太慢：丢失 {0} 行"),
    "damaged": ("{0} damaged lines from the daemon", "守护进程发来 {0} 行损坏数据"),
    "no_estimate": ("no estimate yet", "尚无估计值"),
    "undetermined": ("undetermined", "未确定"),
    "sigma": ("mm (1σ)", "mm (1σ)"),
    "ZUPT": ("at rest (ZUPT)", "静止 (ZUPT)"),
    "VVS": ("starts or stops (VVS)", "变速段 (VVS)"),
    "CVS": ("constant speed (CVS)", "匀速段 (CVS)"),
    "sensor": ("displacement sensor", "位移传感器"),
    "sensor_short": ("sensor", "传感器"),
    "sensor_ok": ("ok", "正常"),
    "sensor_late": ("late", "滞后"),
    "sensor_silent": ("silent", "无数据"),
    "sensor_stuck": ("stuck", "卡死"),
    "sensor_out_of_range": ("out of range", "超出范围"),
    "sensor_invalid": ("invalid", "无效"),
    "sensor_biased": ("biased", "有偏差"),
    "sensor_absent": ("absent", "不存在"),
    "move": ("move", "动作"),
    "push": ("push", "推溜"),
    "retract": ("retract", "收回"),
    "last_time": ("{0} s", "{0} 秒"),
    "parts": ("Parts", "部件"),
    "parts_then": ("Parts, as they were", "部件（旧状态）"),
    "moves": ("Moves", "动作"),
    "events": ("Events", "事件"),
    "none_yet": ("none since this view was opened", "打开本视图以来没有"),
    "since": ("since", "自"),
    "keys": ("q quit   p pause", "q 退出   p 暂停"),
    "keys_paused": ("q quit   p go on", "q 退出   p 继续"),
    "part_ok": ("ok", "正常"),
    "part_ill": ("ILL", "故障"),
    "part_waiting": ("WAITING", "等待"),
    "part_off": ("off", "关闭"),
    "imu": ("imu", "惯性传感器"),
    "jy901": ("jy901", "JY901"),
    "can": ("can", "CAN 总线"),
    "displacement": ("displacement", "位移"),
    "estimator": ("estimator", "估计器"),
    "recorder": ("recorder", "记录器"),
    "loop": ("loop", "事件循环"),
    "too_small": ("terminal too small", "终端太小"),
}


class Words:
    """The words of one language."""

    def __init__(self, language: str = "en") -> None:
        place = LANGUAGES.index(language)
        self._words = {key: texts[place] for key, texts in _TEXTS.items()}

    def __call__(self, key: str, *values: object, default: str | None = None) -> str:
        """The word for `key`; one that is not in the table stands for itself."""
        text = self._words.get(key, key if default is None else default)
        return text.format(*values) if values else text

    def sensor(self, state: str) -> str:
        """The word for what the displacement sensor is thought to be."""
        return self(f"sensor_{state}", default=state)
