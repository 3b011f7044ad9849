// What the daemon says in words, in Chinese. What is not here is shown as it came.

const CHINESE = [
  // displacement sensor
  [/^no displacement has come yet$/, "尚未收到位移数据"],
  [/^check that the controller is on and sends the frame$/, "检查电液控制器是否通电并发送该报文"],
  [/^the displacement has fallen silent$/, "位移数据中断"],
  [/^check the CAN cable and that the controller is switched on$/, "检查 CAN 电缆，以及电液控制器是否通电"],
  [/^the displacement stands still although the ram moves$/, "千斤顶在动作，位移读数却不变"],
  [/^check the magnet and the sensor's cable at the ram$/, "检查千斤顶处的磁环和传感器电缆"],
  [/^the displacement is outside the stroke$/, "位移读数超出行程范围"],
  [/^check the sensor, and \[support\] stroke_mm and the frame's layout$/, "检查传感器、[support] stroke_mm 和报文格式"],
  [/^the controller marks the displacement as invalid$/, "电液控制器将位移标记为无效"],
  [/^check the sensor at the ram$/, "检查千斤顶处的传感器"],
  [/^the displacement does not fit the motion that is felt$/, "位移读数与测得的运动不符"],
  [/^drive to a stop and compare; check the sensor's rod$/, "推到止点进行比对；检查传感器测杆"],
  [/^no frame (\S+) yet$/, "尚未收到报文 $1"],
  [/^no frame (\S+) for (\S+) s$/, "已 $2 s 没有收到报文 $1"],
  [/^check that the controller is switched on, its cable, the bit rate and the identifier \(candump shows it\)$/,
    "检查电液控制器是否通电、电缆、波特率和报文标识符（可用 candump 查看）"],
  [/^check magnet, cable and supply of the sensor; its manual explains the code$/, "检查磁环、电缆和传感器供电；代码含义见传感器说明书"],
  // CAN
  [/^(\S+) is bus-off: too many errors while sending$/, "$1 处于 bus-off（总线关闭）状态：发送错误过多"],
  [/^no acknowledgement on (\S+): no other node confirms a frame$/, "$1 上没有应答：没有其他节点确认报文"],
  [/^no frame at all for (\S+) s although (\S+) is up$/, "$2 已启用，但 $1 s 内没有任何报文"],
  [/^check CANH\/CANL wiring, bit rate and that the controller is switched on$/, "检查 CANH/CANL 接线、波特率，以及电液控制器是否通电"],
  [/^check CANH, CANL, the 120 ohm resistors at both ends and the bit rate$/, "检查 CANH、CANL、两端的 120 Ω 终端电阻和波特率"],
  // inertial sensor
  [/^not started yet$/, "尚未启动"],
  [/^the part is being started$/, "传感器正在启动"],
  [/^the part is looked for on the serial line$/, "正在串口上查找传感器"],
  [/^this takes a second or two$/, "需要一两秒"],
  [/^nothing comes on the serial line$/, "串口没有数据"],
  [/^check the sensor's cable and its supply$/, "检查传感器的电缆和供电"],
  [/^check the sensor's supply$/, "检查传感器供电"],
  [/^check that the sensor is plugged in and its chip select \(CS\)$/, "检查传感器是否插好，以及片选线（CS）"],
  [/^samples are all zeros$/, "采样全为零"],
  // estimate, recorder, loop
  [/^no estimate yet$/, "尚无估计值"],
  [/^wait for the sensors$/, "等待传感器就绪"],
  [/^the stroke is undetermined$/, "行程无法确定"],
  [/^drive to a mechanical stop, or get the displacement sensor to work$/, "推到机械止点，或恢复位移传感器"],
  [/^nothing is recorded: (.*)$/, "没有记录数据：$1"],
  [/^check \[recording\] directory, its rights and the free space$/, "检查 [recording] directory、其权限和剩余空间"],
  [/^(\d+) messages are not recorded$/, "$1 条消息未能记录"],
  [/^check the disk: it is full, failing or too slow$/, "检查磁盘：已满、故障或过慢"],
  [/^(\d+) messages wait for the disk$/, "$1 条消息等待写盘"],
  [/^use a faster disk or card, or see what keeps the computer busy$/, "更换更快的磁盘或存储卡，或查看计算机在忙什么"],
  [/^the event loop was (\S+) ms late: .*$/, "程序延迟了 $1 ms"],
  [/^see what else the computer does$/, "查看计算机上还有哪些程序在运行"],
  // events
  [/^start proposed \(push\)$/, "推溜：疑似启动"],
  [/^start proposed \(retract\)$/, "拉架：疑似启动"],
  [/^start confirmed \(push\)$/, "推溜：确认启动"],
  [/^start confirmed \(retract\)$/, "拉架：确认启动"],
  [/^start discarded \(push\)$/, "推溜：启动被否定"],
  [/^start discarded \(retract\)$/, "拉架：启动被否定"],
  [/^stop proposed \(push\)$/, "推溜：疑似停止"],
  [/^stop proposed \(retract\)$/, "拉架：疑似停止"],
  [/^stop confirmed \(push\)$/, "推溜：确认停止"],
  [/^stop confirmed \(retract\)$/, "拉架：确认停止"],
  [/^stop discarded \(push\)$/, "推溜：停止被否定"],
  [/^stop discarded \(retract\)$/, "拉架：停止被否定"],
  [/^stop of a move whose start was missed \(push\)$/, "推溜：停止（未检测到其启动）"],
  [/^stop of a move whose start was missed \(retract\)$/, "拉架：停止（未检测到其启动）"],
  [/^gap of (\S+) s in the inertial samples$/, "惯性采样中断 $1 s"],
  [/^another inertial sensor: its errors are learned anew$/, "惯性传感器已更换：重新学习其误差"],
  [/^the inertial sensor is silent: only the displacement sensor can tell the stroke now$/, "惯性传感器无信号：目前只能由位移传感器确定行程"],
  [/^no displacement reading: the saved stroke is believed$/, "没有位移读数：采用保存的行程"],
  [/^the sensor is tilted by (\S+) degrees: check \[mount\] push and up$/, "传感器倾斜 $1 度：检查 [mount] push 和 up"],
  [/^at rest again after an unexplained motion$/, "不明运动之后恢复静止"],
  [/^motion that is neither a push nor a retract$/, "既非推溜也非拉架的运动"],
  [/^a move that cannot be felt: following the displacement sensor$/, "惯性传感器感觉不到的动作：跟随位移传感器"],
  [/^the displacement sensor still moves: the stop was none, move re-opened$/, "位移传感器仍在变化：并未停止，动作继续"],
  [/^the displacement sensor moves although no start was felt: following it$/, "未检测到启动但位移在变化：跟随位移传感器"],
  [/^no stop was felt, but the displacement sensor stands: move ended$/, "未检测到停止但位移不变：动作结束"],
  [/^the displacement sensor changed its speed and the ram did not: not believed$/, "位移传感器速度突变而千斤顶没有变化：不予采信"],
];

/** The sentence in the language; a list of complaints is told one by one. */
export function told(sentence, language) {
  if (language !== "zh" || !sentence) return sentence;
  return known(sentence) ?? sentence.split("; ").map((part) => known(part) ?? part).join("；");
}

function known(part) {
  const found = CHINESE.find(([pattern]) => pattern.test(part));
  return found && part.replace(...found);
}
