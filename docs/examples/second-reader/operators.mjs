// Lists of operators: ONNX's own, and what the specification says of them.

const words = (text) => new Set(text.trim().split(/[\s,]+/));

// M17: the operators of the profile `portable-1`, for operator sets 13 to 20.
export const PORTABLE_1 = words(`Abs, Acos, Acosh, Add, And, ArgMax, ArgMin, Asin, Asinh, Atan, Atanh,
  AveragePool, BatchNormalization, Cast, CastLike, Ceil, Clip, Concat, Constant, Conv, ConvTranspose,
  Cos, Cosh, CumSum, DepthToSpace, DequantizeLinear, Div, Einsum, Elu, Equal, Erf, Exp, Expand, Flatten,
  Floor, Gather, GatherElements, GatherND, Gemm, GlobalAveragePool, Greater, GreaterOrEqual,
  HardSigmoid, HardSwish, Identity, InstanceNormalization, LayerNormalization, LeakyRelu, Less,
  LessOrEqual, Log, LogSoftmax, LpNormalization, MatMul, Max, MaxPool, Min, Mul, Neg, Not, PRelu, Pad,
  Pow, Reciprocal, ReduceL1, ReduceL2, ReduceLogSumExp, ReduceMax, ReduceMean, ReduceMin, ReduceProd,
  ReduceSum, ReduceSumSquare, Relu, Reshape, Resize, ScatterElements, ScatterND, Shape, Sigmoid, Sin,
  Sinh, Slice, Softmax, Softplus, Split, Sqrt, Squeeze, Sub, Tan, Tanh, ThresholdedRelu, Tile, TopK,
  Transpose, Trilu, Unsqueeze, Where`);

// I23: the operators of ONNX's own domain that portable-1 does not have, by ONNX's documentation.
export const ONNX = new Set([...PORTABLE_1, ...words(`AffineGrid Attention Bernoulli BitCast BitShift
  BitwiseAnd BitwiseNot BitwiseOr BitwiseXor BlackmanWindow CausalConvWithState Celu CenterCropPad
  Col2Im Compress ConcatFromSequence ConstantOfShape ConvInteger CumProd DFT DeformConv Det Dropout
  DynamicQuantizeLinear EyeLike GRU Gelu GlobalLpPool GlobalMaxPool GridSample GroupNormalization
  HammingWindow HannWindow Hardmax If ImageDecoder IsInf IsNaN LRN LSTM LinearAttention Loop LpPool
  MatMulInteger MaxRoiPool MaxUnpool Mean MeanVarianceNormalization MelWeightMatrix Mish Mod
  Multinomial NegativeLogLikelihoodLoss NonMaxSuppression NonZero OneHot Optional OptionalGetElement
  OptionalHasElement Or QLinearConv QLinearMatMul QuantizeLinear RMSNormalization RNN RandomNormal
  RandomNormalLike RandomUniform RandomUniformLike Range ReduceLogSum RegexFullMatch ReverseSequence
  RoiAlign RotaryEmbedding Round STFT Scan Scatter Selu SequenceAt SequenceConstruct SequenceEmpty
  SequenceErase SequenceInsert SequenceLength SequenceMap Shrink Sign Size SoftmaxCrossEntropyLoss
  Softsign SpaceToDepth SplitToSequence StringConcat StringNormalizer StringSplit Sum SwiGLU Swish
  TensorScatter TfIdfVectorizer Unique Upsample Xor`)]);

// Attributes without which ONNX's checker refuses a node (I22.1).
export const REQUIRED_ATTRIBUTE = {Concat: 'axis', Cast: 'to', Einsum: 'equation', If: 'then_branch',
  Loop: 'body', Scan: 'body', DepthToSpace: 'blocksize', SpaceToDepth: 'blocksize', BitCast: 'to',
  AveragePool: 'kernel_shape', MaxPool: 'kernel_shape', LpPool: 'kernel_shape', BitShift: 'direction',
  RandomNormal: 'shape', RandomUniform: 'shape', GroupNormalization: 'num_groups', LRN: 'size',
  ConcatFromSequence: 'axis'};

// The fewest inputs of operators with more than one, and operators with exactly one (I22.1).
export const FEWEST = {...Object.fromEntries([...words(`Add Sub Mul Div Pow Mod And Or Xor Equal Greater Less
  GreaterOrEqual LessOrEqual PRelu MatMul Gather GatherElements GatherND Reshape Expand Tile Compress
  Unsqueeze TopK Conv ConvTranspose Gemm CastLike Pad CumSum LayerNormalization Loop`)].map((op) => [op, 2])),
  Where: 3, Slice: 3, ScatterND: 3, ScatterElements: 3, Range: 3, GroupNormalization: 3,
  InstanceNormalization: 3, BatchNormalization: 5, Constant: 0, RandomNormal: 0, RandomUniform: 0};
export const UNARY = words(`Abs Acos Acosh Asin Asinh Atan Atanh Bernoulli Cast Ceil Cos Cosh Elu Erf Exp
  Flatten Floor Gelu HardSigmoid HardSwish Identity If IsNaN LeakyRelu Log Neg NonZero Not
  RandomNormalLike RandomUniformLike Reciprocal Relu Round Selu Shape Sigmoid Sign Sin Sinh Softmax
  Softplus Softsign Sqrt Tan Tanh Transpose`);
export const CONTROL_FLOW = words('If Loop Scan'); // I24
export const RANDOM = words('RandomNormal RandomNormalLike RandomUniform RandomUniformLike Multinomial');
export const VALUE_SHAPED = words('NonZero Compress Unique NonMaxSuppression'); // GG004
// GG016: a view, or an update in place.
export const VIEWS = words('Reshape Flatten Squeeze Unsqueeze Identity ScatterND ScatterElements');
export const NO_KERNEL = words('Round Mod Sign'); // GG006's page names these three
// Operators whose newest version before 26 is that of operator set 22, by ONNX's changelog.
export const OF_22 = words(`Acos Acosh Asin Asinh Atan Atanh AveragePool Bernoulli Conv ConvTranspose Cos
  Cosh DeformConv Det Dropout Elu EyeLike GRU GlobalAveragePool GlobalLpPool GlobalMaxPool GridSample
  HardSigmoid HardSwish InstanceNormalization LSTM LpNormalization LpPool MaxPool MaxRoiPool MaxUnpool
  Mish Multinomial RNN RandomNormal RandomUniform RoiAlign Round Selu Sin Sinh Softplus Softsign Tan
  ThresholdedRelu`);
export const COMPARISONS = words('Greater GreaterOrEqual Less LessOrEqual Equal And Or Xor Not IsNaN IsInf');
export const ELEMENTWISE = words(`Abs Acos Acosh Add And Asin Asinh Atan Atanh Ceil Celu Clip Cos Cosh Div
  Elu Equal Erf Exp Floor Gelu Greater GreaterOrEqual HardSigmoid HardSwish Identity IsInf IsNaN
  LeakyRelu Less LessOrEqual Log Max Mean Min Mish Mod Mul Neg Not Or PRelu Pow Reciprocal Relu Round
  Selu Sigmoid Sign Sin Sinh Softplus Softsign Sqrt Sub Sum Swish Tan Tanh ThresholdedRelu Xor`);
